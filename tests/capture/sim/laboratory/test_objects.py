"""The parts of the objects: closed, in place, and the same for the same seed."""

import numpy as np
import pytest

from koala3d.capture.sim.laboratory import objects
from koala3d.capture.sim.laboratory.materials import Glass, Metal


def lidar() -> dict[str, objects.Part]:
    return {part[0]: part for part in objects.lidar_guts(np.random.default_rng(0))}


def test_the_ball_has_its_radius_everywhere() -> None:
    ((_, ball, material, smooth),) = objects.shiny_ball()
    np.testing.assert_allclose(np.linalg.norm(ball.vertices, axis=1), 0.1, atol=1e-9)
    assert ball.is_watertight and smooth and isinstance(material, Metal) and material.roughness < 0.05


def test_the_lidar_stands_on_the_table() -> None:
    parts = lidar()
    assert min(mesh.bounds[0][2] for _, mesh, _, _ in parts.values()) == pytest.approx(0.0, abs=1e-9)
    lower, upper = (
        np.min([p[1].bounds[0] for p in parts.values()], axis=0),
        np.max([p[1].bounds[1] for p in parts.values()], axis=0),
    )
    assert (upper - lower < 0.2).all() and (upper - lower > 0.08).all()


def test_the_boards_do_not_overlap_their_chips() -> None:
    board, chips, _ = objects._board(np.random.default_rng(1), (0.15, 0.11), 12)
    assert board.extents[2] == pytest.approx(0.0016) and len(chips.split()) == 12
    boxes = np.array([chip.bounds[:, :2] for chip in chips.split()])
    for index, (lower, upper) in enumerate(boxes):
        others = np.delete(boxes, index, axis=0)
        apart = (lower > others[:, 1]) | (upper < others[:, 0])
        assert apart.any(axis=1).all(), "two chips stand in one another"
    assert (np.abs(boxes) <= np.array([0.075, 0.055])).all()


def test_the_lens_is_flat_on_one_side_and_bulges_on_the_other() -> None:
    lens = objects._lens(0.0165, 0.007)
    assert lens.is_watertight and lens.is_convex
    np.testing.assert_allclose(lens.bounds[:, 2], [-0.002, 0.007], atol=1e-5)  # the hull cuts the apex by 6 um
    sphere = (0.0165**2 + 0.007**2) / (2 * 0.007)
    cap = lens.vertices[lens.vertices[:, 2] > 1e-6]
    np.testing.assert_allclose(np.linalg.norm(np.add(cap, [0, 0, sphere - 0.007]), axis=1), sphere, atol=1e-6)


def test_glass_parts_are_closed() -> None:
    """A renderer needs to know on which side of the surface light is."""
    crystals = objects.crystal_capture(np.random.default_rng(2))
    glass = [mesh for _, mesh, material, _ in [*crystals, *lidar().values()] if isinstance(material, Glass)]
    assert len(glass) == 2 and all(mesh.is_watertight and mesh.volume > 0 for mesh in glass)


def test_crystals_lean_outwards_and_stay_above_the_table() -> None:
    parts = {name: mesh for name, mesh, _, _ in objects.crystal_capture(np.random.default_rng(2))}
    crystals = parts["crystals"].split()
    assert len(crystals) == 8 and parts["crystals"].bounds[0][2] >= 0.001 - 1e-9 and parts["stone"].bounds[0][2] >= 0
    for crystal in crystals[1:]:
        top = crystal.vertices[crystal.vertices[:, 2].argmax()]
        foot = crystal.vertices[crystal.vertices[:, 2] < 0.02].mean(axis=0)
        assert np.linalg.norm(top[:2]) > np.linalg.norm(foot[:2])


def test_another_seed_is_another_crystal() -> None:
    same, again, other = (objects.crystal_capture(np.random.default_rng(seed))[1][1].vertices for seed in (5, 5, 6))
    np.testing.assert_array_equal(same, again)
    assert same.shape != other.shape or not np.allclose(same, other)
