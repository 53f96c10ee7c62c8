import numpy as np
import pytest

from koala3d.capture.sim.truth import FOCAL_PX, RigTruth
from koala3d.datasets import pose

NOMINAL = pose.from_rotation_vector([0.7, 0, 0.1], [0, 0.06, 0.08])


@pytest.mark.parametrize("seed", range(5))
def test_mount_is_off_by_what_brackets_are_off(seed):
    distance, angle = pose.difference(NOMINAL, RigTruth.draw(NOMINAL, seed).flange_from_camera)
    assert distance == pytest.approx(3e-3) and np.degrees(angle) == pytest.approx(1.0)


def test_seed_is_the_rig():
    first, again, other = (RigTruth.draw(NOMINAL, seed) for seed in (1, 1, 2))
    assert first.sensor_camera == again.sensor_camera != other.sensor_camera
    assert np.array_equal(first.flange_from_camera, again.flange_from_camera)


@pytest.mark.parametrize("seed", range(20))
def test_lens_is_one_that_can_be_inverted_over_the_sensor(seed):
    camera = RigTruth.draw(NOMINAL, seed).sensor_camera
    corners = np.array([[0, 0], [1920, 0], [0, 1080], [1920, 1080], [960, 0], [0, 540]], float)
    np.testing.assert_allclose(camera.project(camera.directions(corners)), corners, atol=1e-6)
    assert abs(camera.fx / FOCAL_PX - 1) < 0.03 and camera.k1 < -0.05
