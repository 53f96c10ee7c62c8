"""Axes of turntables from orientations that are known exactly, and from noisy ones."""

import numpy as np
from scipy.spatial.transform import Rotation

from koala3d.datasets import pose
from koala3d.reconstruct.scene.turntable import turning

AXIS = np.array([0.36, -0.48, 0.8])


def turned(heights: tuple[float, ...], count: int, noise_deg: float = 0.0) -> np.ndarray:
    """Orientations of an upright camera at some heights, `count` each, as an object turns about `AXIS`."""
    tilt, _ = Rotation.align_vectors([AXIS], [[0, 0, 1.0]])
    cameras = [pose.look_at((1.0, 0.0, height), (0, 0, 0))[:3, :3] for height in heights]
    angles = 2 * np.pi * np.arange(count) / count
    rotations = [tilt.as_matrix() @ Rotation.from_rotvec([0, 0, a]).as_matrix() @ each for each in cameras for a in angles]
    noise = Rotation.from_rotvec(np.deg2rad(noise_deg) * np.random.default_rng(0).normal(size=(len(rotations), 3)))
    return noise.as_matrix() @ np.stack(rotations)


def test_the_axis_is_found_and_points_up() -> None:
    found = turning(turned((0.2, 0.9), 12))
    assert found is not None
    np.testing.assert_allclose(found.axis, AXIS, atol=1e-6)
    assert found.on_rings == 1
    # of the 276 pairs 132 are of one ring; half a turn, 12 of them, tells no axis
    assert found.agreeing > 0.4


def test_noise_of_a_tenth_of_a_degree_moves_it_by_less() -> None:
    found = turning(turned((0.2, 0.9), 12, noise_deg=0.1))
    assert found is not None and found.on_rings > 0.95
    assert np.rad2deg(np.arccos(found.axis @ AXIS)) < 0.1


def test_cameras_all_around_are_on_no_rings() -> None:
    positions = np.random.default_rng(1).normal(size=(30, 3))
    positions[:, 2] = np.abs(positions[:, 2])
    found = turning(np.stack([pose.look_at(p / np.linalg.norm(p), (0, 0, 0))[:3, :3] for p in positions]))
    assert found is not None and found.on_rings < 0.5 and found.agreeing < 0.1


def test_views_without_rotation_tell_no_axis() -> None:
    assert turning(np.stack([np.eye(3)] * 4)) is None
    assert turning(np.eye(3)[None]) is None
