"""Masks of a ball, exact unless a test spoils one."""

from dataclasses import replace

import numpy as np
import pytest

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.structure.bounds import grid
from koala3d.datasets.structure.masks import votes
from koala3d.datasets.structure.masks.silhouette import EXACT, Silhouette, Slack, distance_to
from koala3d.datasets.structure.masks.votes import FEWEST, carved, needed

CAMERA = Camera(128, 128, 90, 90, 64, 64)
DISTANCE, RADIUS = 4.0, 1.0


def looking_at_origin(position: np.ndarray) -> np.ndarray:
    z = -position / np.linalg.norm(position)
    x = np.cross([0.3, 0.8, 0.1], z)
    x /= np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3] = np.stack([x, np.cross(z, x), z, position], axis=1)
    return matrix


def silhouettes(count: int = 20, camera: Camera = CAMERA) -> list[Silhouette]:
    """Views from all around; the ball fills a disc of 23 px in each."""
    positions = np.random.default_rng(1).normal(size=(count, 3))
    positions *= DISTANCE / np.linalg.norm(positions, axis=1, keepdims=True)
    rays = camera.directions(camera.pixel_centres())
    found = []
    for matrix in map(looking_at_origin, positions):
        along = rays[..., 2] * DISTANCE / (rays**2).sum(-1)
        miss = np.linalg.norm(rays * along[..., None] - [0, 0, DISTANCE], axis=-1)
        found.append(Silhouette(camera, matrix, miss < RADIUS))
    return found


BOX, CELLS = np.array([[-1.6] * 3, [1.6] * 3]), 32
POINTS, CELL = grid(BOX, CELLS), np.sqrt(3) / CELLS * 1.6
"""Centres of the cells, and half a cell's diagonal."""


def left(views: list[Silhouette], **rule: object) -> np.ndarray:
    found = np.zeros(len(POINTS), bool)
    found[carved(views, BOX, CELLS, **rule)] = True
    return found


def test_exact_masks_leave_the_object_and_little_else() -> None:
    kept, distance = left(silhouettes()), np.linalg.norm(POINTS, axis=1)
    assert kept[distance < RADIUS].all(), "no part of the object is ruled out"
    assert not kept[distance > RADIUS + 2 * CELL + 0.3].any(), "0.3: two of twenty views must miss it"


@pytest.mark.parametrize("wrong", [lambda inside: inside & False, lambda inside: inside & (np.arange(128) < 57)])
def test_one_wrong_mask_among_many_rules_nothing_out(wrong) -> None:
    views = silhouettes()
    spoilt = [replace(views[0], inside=wrong(views[0].inside)), *views[1:]]
    distance = np.linalg.norm(POINTS, axis=1)
    assert spoilt[0].votes(POINTS.T, CELL)[1][distance < 0.9 * RADIUS].any(), "premise: it votes against"
    assert left(spoilt)[distance < RADIUS].all()
    assert left(spoilt).sum() < 1.3 * left(views).sum(), "the others still rule out"


def test_many_wrong_masks_do_rule_out() -> None:
    views = silhouettes()
    spoilt = [replace(view, inside=view.inside & False) for view in views[:4]]
    assert not left([*spoilt, *views[4:]]).any()


def test_what_a_picture_does_not_show_it_cannot_rule_out() -> None:
    """Pictures that end in the middle of the ball, all masks of which are empty, leave what lies beyond them."""
    half = replace(CAMERA, width=64)
    views = [Silhouette(half, view.world_from_camera, np.zeros((128, 64), bool)) for view in silhouettes(1) * 3]
    across = POINTS @ views[0].world_from_camera[:3, 0]
    kept = left(views)
    assert kept[across > 0.01].all() and not kept[(across < -0.01) & (np.linalg.norm(POINTS, axis=1) < 1)].any()


def test_a_camera_that_may_stand_elsewhere_rules_out_less() -> None:
    (view,) = silhouettes(1)
    exact, moved, turned = (replace(view, slack=slack).votes(POINTS.T, CELL)[1].sum() for slack in ((0, 0), (0.1, 0), (0, 0.05)))
    assert exact > moved > 0 and exact > turned > 0


@pytest.mark.parametrize("rule", [{}, {"centres": True, "share": 0.13}, {"seen_by": 6}])
@pytest.mark.parametrize("slack", [EXACT, (0.05, 0.01)])
def test_blocks_change_nothing(monkeypatch: pytest.MonkeyPatch, rule: dict, slack: Slack) -> None:
    """Pictures cut the object, so that some cells are shown and their blocks are not."""
    narrow, found = silhouettes(camera=replace(CAMERA, width=60, cx=30.0)), []
    narrow = [replace(view, slack=slack) for view in narrow]
    for block in (5, 4):  # 5 does not divide 32: no blocks
        monkeypatch.setattr(votes, "BLOCK", block)
        found.append(left(narrow, **rule))
    np.testing.assert_array_equal(*found)
    assert found[0].any() and not found[0].all()


def test_centres_leave_less_than_whole_cells() -> None:
    whole, centres = left(silhouettes()), left(silhouettes(), centres=True)
    assert whole[centres].all() and centres.sum() < whole.sum()
    assert centres[np.linalg.norm(POINTS, axis=1) < RADIUS].all()


def test_cells_that_few_views_see_are_left_only_if_few_are_asked_for() -> None:
    views = silhouettes(20)
    seen = sum(view.votes(POINTS.T, CELL)[0].astype(int) for view in views)
    assert seen.min() < 15 <= seen.max(), "premise: pictures end before the box does"
    np.testing.assert_array_equal(left(views, seen_by=15), left(views) & (seen >= 15))


def test_unexplained_pixels_are_those_that_see_nothing_of_the_hull() -> None:
    ball = POINTS[np.linalg.norm(POINTS, axis=1) < RADIUS]
    view = silhouettes(1)[0]
    assert view.unexplained(ball, CELL) == 0
    cut = ball[ball @ view.world_from_camera[:3, 0] < 0]
    assert 0.3 < view.unexplained(cut, CELL) < 0.5, "half of the ball, less what a cell covers"
    assert view.unexplained(ball[:0], CELL) == 1


def test_votes_are_several_and_a_share() -> None:
    np.testing.assert_array_equal(needed(np.array([1, 5, 20, 21, 100])), [FEWEST, FEWEST, 2, 3, 10])


def test_distance_is_to_the_nearest_pixel_inside() -> None:
    inside = np.zeros((5, 9), bool)
    inside[2, 1] = True
    rows, columns = np.mgrid[:5, :9]
    np.testing.assert_allclose(distance_to(inside), np.hypot(rows - 2, columns - 1), atol=1e-5)
    assert np.isinf(distance_to(inside & False)).all()
