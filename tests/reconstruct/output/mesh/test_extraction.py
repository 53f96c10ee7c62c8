import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.output.mesh import extraction, field_samples, files
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.run import Run

CENTRE, RADIUS = np.array([0.4, 0.0, 0.15]), 0.08
DENSITY, WIDTH = 2000.0, 0.002
"""Of the ball's field: DENSITY * sigmoid((radius - r) / WIDTH), in scene units of 0.1 m."""


def expected_radius(level: float) -> float:
    """Where the ball's density is such that 1/128 of the box, 2/128 scene units, absorbs `level` [m]."""
    density = -np.log(1 - level) * 128 / 2
    return RADIUS + 0.1 * WIDTH * np.log(DENSITY / density - 1)


@pytest.mark.parametrize(("resolution", "level"), [(48, 0.5), (160, 0.5), (160, 0.9)])
def test_the_ball_comes_out_where_it_is(ball: TrainedModel, resolution: int, level: float) -> None:
    """World coordinates and the same surface at any resolution.

    The log-density is linear outside the surface, so that linear interpolation is exact there but for the curvature over
    a grid cell: h^2 / (8 r), and the sigmoid's knee.
    """
    surface = extraction.extract(ball, resolution=resolution, level=level)
    radii = np.linalg.norm(surface.vertices - CENTRE, axis=-1)
    spacing = 0.2 / (resolution - 1)
    assert np.abs(np.median(radii) - expected_radius(level)) < spacing**2 / (8 * RADIUS) + 0.25 * spacing
    assert np.abs(radii - expected_radius(level)).max() < 0.6 * spacing


def test_the_surface_follows_predicted_normals_where_there_are_any(ball: TrainedModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """The ball's normals are exact: below 1/24 of the box, two cells at 48 points, only its roughness remains."""
    rough, smooth = extraction.extract(ball, resolution=48, follow=False), extraction.extract(ball, resolution=48)
    spread = [np.std(np.linalg.norm(surface.vertices - CENTRE, axis=-1)) for surface in (rough, smooth)]
    assert spread[1] < 0.5 * spread[0]
    assert abs(smooth.volume / rough.volume - 1) < 0.01
    monkeypatch.setattr(type(ball.model.field.appearance), "predicts_normals", False)
    np.testing.assert_array_equal(extraction.extract(ball, resolution=48).vertices, rough.vertices)


def test_it_is_closed_faces_outward_and_shows_the_colour(ball: TrainedModel, tmp_path: Path) -> None:
    surface = extraction.extract(ball, resolution=96)
    assert surface.is_watertight and surface.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.05)
    outward = (surface.vertices - CENTRE) / np.linalg.norm(surface.vertices - CENTRE, axis=-1, keepdims=True)
    assert (np.sum(outward * surface.vertex_normals, -1) > 0.97).all()  # within 14 degrees, on facets of 1.5 degrees
    linear = np.array([0.3, 0.3, 0.35])  # diffuse and specular of the ball
    expected = 255 * (1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(surface.visual.vertex_colors[:, :3] - expected).max() <= 1
    files.save(surface, tmp_path / "ball.ply")
    again = trimesh.load_mesh(tmp_path / "ball.ply")
    assert len(again.faces) == len(surface.faces) and np.allclose(again.vertices, surface.vertices, atol=1e-6)
    assert list(tmp_path.glob("*.ply")) == [tmp_path / "ball.ply"]


def test_density_is_looked_up_near_occupied_cells_alone(ball: TrainedModel) -> None:
    axes = field_samples.grid_axes(ball, 65)
    wanted = ball.model.sampler.near_occupied(axes)
    distance = np.linalg.norm(np.stack(np.meshgrid(*axes, indexing="ij"), -1), axis=-1)
    cell = 2 / ball.model.sampler.grid.grid
    assert wanted[np.abs(distance - 0.8) < 0.5 * cell].all()
    assert not wanted[np.abs(distance - 0.8) > 5 * cell].any()
    assert not field_samples.sample_density(ball, axes)[~wanted].any()


def test_noise_is_left_out() -> None:
    large, small = trimesh.creation.icosphere(radius=1.0), trimesh.creation.icosphere(radius=0.1)
    small.apply_translation([3, 0, 0])
    kept = extraction.main_parts(trimesh.util.concatenate([large, small]))
    assert len(kept.faces) == len(large.faces) and kept.extents.max() == pytest.approx(2)


def test_cavities_are_left_out_and_open_pieces_are_kept() -> None:
    solid, cavity, sheet = trimesh.creation.icosphere(radius=1.0), trimesh.creation.icosphere(radius=0.5), trimesh.creation.box()
    cavity.invert()
    sheet.update_faces(np.arange(len(sheet.faces)) > 1)
    sheet.invert()
    sheet.apply_translation([3, 0, 0])
    kept = extraction.main_parts(trimesh.util.concatenate([solid, cavity, sheet]))
    assert len(kept.faces) == len(solid.faces) + len(sheet.faces)


def test_the_grid_covers_a_box_that_is_not_a_cube(ball: TrainedModel) -> None:

    box = ball.scene.box * [1, 1, 1]
    box[1, 2] = box[0, 2] + 0.05
    axes = field_samples.grid_axes(replace(ball, scene=replace(ball.scene, box=box)), 41)
    assert [len(axis) for axis in axes] == [41, 41, 11]
    assert np.allclose([axis[0] for axis in axes], -1) and np.ptp(axes[2]) == pytest.approx(0.5)


def test_no_surface_is_one_clear_error(make_run: Callable[..., Run]) -> None:
    trained = TrainedModel.open(make_run().path)
    empty = eqx.tree_at(lambda m: m.sampler.grid.depth, trained.model, jnp.zeros_like(trained.model.sampler.grid.depth))

    with pytest.raises(ReconstructError, match="no surface in the object's box"):
        extraction.extract(replace(trained, model=empty), resolution=32)


def test_a_closed_surface_states_what_it_encloses(ball: TrainedModel, tmp_path: Path) -> None:
    """The deviations are of the surfaces on either side, whose radii are known, and of the stated motion."""
    surface = extraction.extract(ball, resolution=96, follow=False)
    found, text = extraction.summary(surface, ball.scene)
    outer, middle, inner = (4 / 3 * np.pi * expected_radius(level) ** 3 for level in (0.16, 0.5, 0.84))
    assert found["volume"] == pytest.approx(middle, rel=0.01) and found["volume"] == pytest.approx(surface.volume)
    assert found["volume_deviation"] == pytest.approx((outer - inner) / 2, rel=0.3)  # a third of a cell
    np.testing.assert_allclose(found["centre_of_mass"], CENTRE, atol=1e-4)
    assert max(found["centre_of_mass_deviation"]) < 1e-4
    cubic, off = re.search(r"volume ([\d.]+) ± ([\d.]+) cm3, centre of mass at", text).groups()
    assert float(cubic) == pytest.approx(1e6 * middle, rel=0.01) and float(off) == pytest.approx(
        1e6 * found["volume_deviation"], rel=0.1
    )
    covariance = np.diag([1e-8, 4e-8, 1e-8, 0, 0, 0])  # 0.2 mm at most
    over = replace(ball.scene, provenance={"turned": {"covariance": covariance.tolist()}})
    apart = extraction.summary(surface, over)[0]
    section = np.pi * expected_radius(0.5) ** 2
    assert apart["volume_deviation"] == pytest.approx(np.hypot(found["volume_deviation"], 2e-4 * section), rel=0.01)
    assert apart["centre_of_mass_deviation"] == pytest.approx((1e-4,) * 3, rel=0.2)
    files.save(surface, tmp_path / "ball.glb")
    assert b"shells" not in (tmp_path / "ball.glb").read_bytes()


def test_a_surface_that_leaves_the_box_can_be_closed(ball: TrainedModel) -> None:
    """Half of the ball is outside a box that ends at its middle."""
    low, high = ball.scene.box
    half = replace(ball, scene=replace(ball.scene, box=np.stack([low, [high[0], high[1], CENTRE[2]]])))
    surface, closed = extraction.extract(half, resolution=64), extraction.extract(half, resolution=64, watertight=True)
    assert "volume" not in extraction.summary(surface, half.scene)[0] and "volume" in extraction.summary(closed, half.scene)[0]
    assert not surface.is_watertight and closed.is_watertight
    assert extraction.sides_reached(surface, half.scene.box) == ["+z"] and extraction.sides_reached(closed, half.scene.box) == []
    assert closed.volume == pytest.approx(2 / 3 * np.pi * RADIUS**3, rel=0.1)


def test_what_reaches_in_from_outside_can_be_left_out(ball: TrainedModel) -> None:
    """The box is cut through the ball from the side: nothing is left but that, and the ball is not taken for surroundings."""
    low, high = ball.scene.box
    half = replace(ball, scene=replace(ball.scene, box=np.stack([[CENTRE[0], *low[1:]], high])))
    whole = extraction.extract(half, resolution=48)
    for side in ("-x", "-z"):
        np.testing.assert_array_equal(extraction.extract(half, resolution=48, stands_on=side).vertices, whole.vertices)


def test_the_summary_names_the_sides_and_what_to_do(ball: TrainedModel) -> None:
    surface = extraction.extract(ball, resolution=32, follow=False)
    found, text = extraction.summary(surface, ball.scene)
    count, sides = re.match(r"(\d+) triangles, ([\d.]+ x [\d.]+ x [\d.]+) m\n", text).groups()
    assert found["open_at"] == [] and int(count) == found["faces"] == len(surface.faces)
    np.testing.assert_allclose(
        [float(side) for side in sides.split(" x ")], 2 * expected_radius(0.5), atol=2e-3
    )  # a third of a cell
    box = np.stack([ball.scene.box[0], [*ball.scene.box[1, :2], CENTRE[2]]])
    half = replace(ball, scene=replace(ball.scene, box=box))
    _, text = extraction.summary(extraction.extract(half, resolution=32), half.scene)
    assert "open at +z, where it leaves the object's box; --watertight" in text
    box = np.stack([[CENTRE[0], *box[0, 1:]], box[1]])
    corner = replace(ball, scene=replace(ball.scene, box=box))
    found, text = extraction.summary(extraction.extract(corner, resolution=32), corner.scene)
    assert found["open_at"] == ["-x", "+z"] and "open at -x, +z" in text and "--stands-on -x removes" in text


def test_a_simpler_mesh_keeps_the_shape_and_its_colours(ball: TrainedModel) -> None:
    fine = extraction.extract(ball, resolution=96)
    simple = extraction.extract(ball, resolution=96, faces=1000)
    assert len(fine.faces) > 5000 and len(simple.faces) <= 1000 and len(simple.visual.vertex_colors) == len(simple.vertices)
    radii = np.linalg.norm(simple.vertices - CENTRE, axis=-1)
    assert np.abs(radii - expected_radius(0.5)).max() < 2e-3  # edges of 1000 triangles are 13 mm long and sag by 0.3 mm
    assert simple.is_watertight


@pytest.mark.parametrize("suffix", files.SUFFIXES)
def test_every_form_is_read_back(ball: TrainedModel, tmp_path: Path, suffix: str) -> None:
    surface = extraction.extract(ball, resolution=32)
    files.save(surface, tmp_path / f"ball{suffix}")
    again = trimesh.load_mesh(tmp_path / f"ball{suffix}", process=False)
    assert len(again.faces) == len(surface.faces)
    np.testing.assert_allclose(again.bounds, surface.bounds, atol=1e-6)


def test_points_lie_on_the_surface_with_colours_and_normals(ball: TrainedModel, tmp_path: Path) -> None:
    surface = extraction.extract(ball, resolution=96)
    cloud = files.points_on(surface, 2000)
    outward = (cloud.vertices - CENTRE) / np.linalg.norm(cloud.vertices - CENTRE, axis=-1, keepdims=True)
    assert (np.sum(outward * cloud.vertex_normals, -1) > 0.97).all()
    files.save(cloud, tmp_path / "points.ply")
    again = trimesh.load(tmp_path / "points.ply")
    np.testing.assert_allclose(again.vertices, cloud.vertices, atol=1e-6)
    np.testing.assert_array_equal(np.asarray(again.colors)[:, :3], cloud.visual.vertex_colors[:, :3])
