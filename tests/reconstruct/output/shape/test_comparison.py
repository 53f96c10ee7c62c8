"""Pieces of one part: as drawn, with a dent, larger, elsewhere; each with noise of stated deviation."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.output.shape import comparison
from koala3d.reconstruct.output.shape.stated import Stated

NOISE = 2e-4
"""Standard deviation of each vertex along its normal [m]."""
DENT, WIDTH = 1e-3, 4e-3
"""Depth and standard deviation of the dent's profile [m]."""


def part(subdivisions: int = 5) -> trimesh.Trimesh:
    """A part of 0.1 m without a symmetry."""
    ball = trimesh.creation.icosphere(subdivisions)
    vertices = 0.05 * ball.vertices * [1, 0.8, 1.2]
    return trimesh.Trimesh(vertices + 0.0075 * np.sin(vertices / 0.02)[:, [1, 2, 0]], ball.faces, process=False)


DRAWN = part()
PLACE = np.asarray(DRAWN.vertices)[1000]
DRAWING = Stated("drawing", DRAWN)


def piece(seed: int = 0, *, dent: float = 0.0, scale: float = 1.0, moved: np.ndarray | None = None) -> Stated:
    """A reconstruction of the part that states its noise."""
    vertices, normals = np.asarray(DRAWN.vertices), np.asarray(DRAWN.vertex_normals)
    depth = dent * np.exp(-np.sum((vertices - PLACE) ** 2, -1) / (2 * WIDTH**2))
    noise = NOISE * np.random.default_rng(seed).normal(size=len(vertices))
    made = trimesh.Trimesh(scale * (vertices + (noise - depth)[:, None] * normals), DRAWN.faces, process=False)
    if moved is not None:
        made.apply_transform(moved)
    return Stated("piece", made, np.full(len(vertices), NOISE), np.zeros(len(vertices)), np.ones(len(vertices), bool))


def somewhere() -> np.ndarray:
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = Rotation.from_rotvec([0.9, -1.1, 1.6]).as_matrix(), [0.3, 0.2, -0.1]
    return found


@pytest.mark.parametrize("seed", range(4))
def test_pieces_as_drawn_are_not_accused(seed: int) -> None:
    found = comparison.compare(piece(seed), DRAWING).to_json()
    assert found["aligned"]["by"] == "icp" and found["significant_share"] < 0.01
    assert found["deviation_m"]["rms"] == pytest.approx(NOISE, rel=0.05)
    assert abs(found["aligned"]["scale"] - 1) < 3 * found["aligned"]["scale_std"] + 1e-5


def test_a_dent_is_found_at_its_place_wherever_the_piece_lies() -> None:
    found = comparison.compare(piece(dent=DENT, moved=somewhere()), DRAWING)
    assert found.aligned.by == "features" and not found.aligned.ambiguous
    (place,) = found.places
    assert np.linalg.norm(place.point - PLACE) < WIDTH / 2, "in the frame of the drawing"
    assert place.std == pytest.approx(NOISE) and abs(place.deviation + DENT) < 1.96 * place.std
    back = np.linalg.inv(somewhere())
    np.testing.assert_allclose(found.aligned.fit.matrix, back, atol=5e-4)
    assert found.aligned.turned_deg == pytest.approx(np.rad2deg(np.linalg.norm([0.9, -1.1, 1.6])), abs=0.1)


def test_the_stated_covariance_of_a_motion_holds() -> None:
    """Squares of errors over the covariance are 1 in the mean, of 48 that vary by 0.2; where errors agree over some centimetres.

    A covariance by 24 patches is known to a third; of its inverse the mean is too large by 24 / (24 - 6 - 2)."""
    normals, vertices, squares = np.asarray(DRAWN.vertex_normals), np.asarray(DRAWN.vertices), []
    for draw in range(8):
        rng = np.random.default_rng(draw)
        waves, phases = rng.normal(0, 2 * np.pi / 0.05, (12, 3)), rng.uniform(0, 2 * np.pi, 12)
        noise = 3e-4 * np.sqrt(2 / 12) * np.sin(vertices @ waves.T + phases).sum(1)
        made = trimesh.Trimesh(vertices + noise[:, None] * normals, DRAWN.faces, process=False)
        fit = comparison.compare(Stated("piece", made.apply_transform(somewhere())), DRAWING, by="features").aligned.fit
        back = fit.matrix @ somewhere()  # the identity, had the fit no error
        shift = back[:3, :3] @ fit.middle + back[:3, 3] - fit.middle
        by = np.concatenate([shift, Rotation.from_matrix(back[:3, :3]).as_rotvec()])
        squares.append(by @ np.linalg.solve(fit.covariance, by) / 6)
    assert 0.3 < np.mean(squares) < 2.5, squares


def test_a_difference_in_size_is_found_and_removed_on_request() -> None:
    kept, removed = (comparison.compare(piece(scale=1.003), DRAWING, scaled=scaled) for scaled in (False, True))
    for one in (kept, removed):
        assert one.aligned.scale == pytest.approx(1.003, abs=1e-4), "a tenth of the 0.1 % that is asked for"
        assert abs(one.aligned.scale - 1.003) < 4 * one.aligned.scale_std
    assert [one.to_json()["aligned"]["scale_removed"] for one in (kept, removed)] == [False, True]
    assert removed.to_json()["deviation_m"]["rms"] == pytest.approx(NOISE, rel=0.05)
    assert kept.to_json()["deviation_m"]["mean"] > 1e-4 > abs(removed.to_json()["deviation_m"]["mean"])


def test_what_stands_in_one_frame_is_left_there() -> None:
    shift = np.eye(4)
    shift[0, 3] = 5e-4
    other = replace(piece(1), name="other")
    found = comparison.compare(piece(moved=shift), other)
    assert (found.aligned.by, found.aligned.moved_m) == ("base", 0.0)
    assert found.aligned.would_move_m == pytest.approx(5e-4, abs=5e-5)
    assert found.std == pytest.approx(np.sqrt(2) * NOISE, rel=1e-6), "both are uncertain"
    placed = replace(other, common=np.full(len(other.mesh.vertices), 1e-3))
    assert comparison.compare(piece(moved=shift), placed).std.min() > 1e-3
    fitted = comparison.compare(piece(moved=shift), placed, by="icp")
    assert fitted.std.max() < 1e-3, "the place is fitted and no longer uncertain"
    assert fitted.significant.mean() < 0.01


def test_outlines_that_are_off_alike_do_not_tell_two_runs_apart() -> None:
    """But a drawing has none of it."""
    off = np.full(len(DRAWN.vertices), 2 * NOISE)
    one, other = replace(piece(0), outline=off), replace(piece(1), outline=off)
    assert comparison.compare(one, other).std == pytest.approx(np.sqrt(2) * NOISE)
    assert comparison.compare(one, DRAWING).std == pytest.approx(np.sqrt(5) * NOISE)
    assert comparison.compare(piece(0), other).std == pytest.approx(np.sqrt(6) * NOISE)


def test_an_unknown_part_is_not_judged() -> None:
    dented = piece(dent=DENT)
    known = np.linalg.norm(np.asarray(DRAWN.vertices) - PLACE, axis=-1) > 4 * WIDTH
    found = comparison.compare(replace(dented, known=known), DRAWING).to_json()
    assert not found["places"] and 0 < found["not_compared_share"] < 0.2


def test_what_is_beyond_the_edge_of_the_other_is_not_compared() -> None:
    half = DRAWN.copy()
    half.update_faces(half.triangles_center[:, 2] > 0)
    half.remove_unreferenced_vertices()
    found = comparison.compare(piece(), Stated("half", half))
    assert 0.4 < found.to_json()["not_compared_share"] < 0.6
    assert found.to_json()["deviation_m"]["rms"] == pytest.approx(NOISE, rel=0.1)


def test_without_stated_errors_nothing_is_significant() -> None:
    found = comparison.compare(Stated("mesh", piece(dent=DENT).mesh), DRAWING, tolerance=7e-4).to_json()
    assert found["significant_share"] is None and found["places"][0]["std_m"] is None
    assert np.linalg.norm(np.subtract(found["places"][0]["point_m"], PLACE)) < WIDTH / 2


def test_a_ball_fits_in_many_poses() -> None:
    ball = trimesh.creation.icosphere(4, radius=0.05)
    found = comparison.compare(Stated("ball", ball.copy().apply_translation([0.4, 0, 0])), Stated("drawing", ball))
    assert found.aligned.ambiguous and found.to_json()["deviation_m"]["rms"] < 1e-4


def test_a_drawing_of_few_triangles_is_measured_in_between() -> None:
    box, larger = trimesh.creation.box((0.1, 0.06, 0.03)), trimesh.creation.box((0.102, 0.06, 0.03))
    found = comparison.compare(Stated("larger", larger), Stated("box", box), by="base")
    ends = np.abs(found.vertices[:, 0]) > 0.0509
    np.testing.assert_allclose(found.deviation[ends], 1e-3, atol=1e-9)
    middle = np.abs(found.vertices[:, 0]) < 0.045
    np.testing.assert_allclose(found.deviation[middle], 0, atol=1e-9)
    assert len(found.vertices) > 1000


def test_refusals_are_one_line() -> None:
    large = DRAWN.copy().apply_scale(1000)
    with pytest.raises(UsageError, match=r"large: unit is probably not the metre .*--unit mm"):
        comparison.compare(piece(), Stated("large", large))
    with pytest.raises(UsageError, match="write it in metres if it is in mm"):
        comparison.compare(Stated("large", large), DRAWING)
    with pytest.raises(UsageError, match="do not overlap as they stand"):
        comparison.compare(piece(moved=somewhere()), DRAWING, by="base")
