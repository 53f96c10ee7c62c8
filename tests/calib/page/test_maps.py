"""How certain a calibration is over the image."""

from dataclasses import replace

import numpy as np
import pytest

from koala3d.calib import calibrate
from koala3d.calib.advice.rehearsal import draw_rig
from koala3d.calib.page import maps
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.kinematics import UR5E
from tests.calib import drawn_arms


@pytest.fixture(scope="module")
def session():
    return drawn_arms.drawn(np.random.default_rng(3), draw_rig(3), UR5E, 14)


@pytest.fixture(scope="module")
def rig(session):
    return calibrate.calibrate_handeye(session, lens="brown")


def test_deviation_is_that_of_rigs_drawn_from_the_covariance(rig):
    """The slow way: cameras and mounts are drawn together, and a point on the flange is projected by each of them."""
    found = maps.projection_uncertainty(rig, 0.4)
    names, covariance = maps._covariance(rig, rig.flange_from_camera)
    camera, mount = rig.camera, rig.flange_from_camera.matrix
    row, column = 5, 20
    direction = camera.directions(np.array([[found.columns[column], found.rows[row]]]))
    point = 0.4 * direction / np.linalg.norm(direction) @ mount[:3, :3].T + mount[:3, 3]
    drawn = np.random.default_rng(0).multivariate_normal(np.zeros(len(names)), covariance, 2000)
    seen = []
    for errors in drawn:
        of_camera = {name: getattr(camera, name) + e for name, e in zip(names[:-6], errors, strict=False)}
        moved = pose.inverse(pose.from_rotation_vector(errors[-3:], errors[-6:-3]) @ mount)
        seen.append(replace(camera, **of_camera).project(point @ moved[:3, :3].T + moved[:3, 3])[0])
    worst = np.sqrt(np.linalg.eigvalsh(np.cov(np.array(seen).T))[-1])
    assert found.values_px[row, column] == pytest.approx(worst, rel=0.07)  # 2000 draws: 1.6 % one sigma


def test_the_middle_is_surer_than_the_corners(rig):
    values = maps.projection_uncertainty(rig, 0.4).values_px
    assert values[13, 24] < 0.3 * values[0, 0] and values.shape == (27, 48)


def test_of_a_camera_alone_a_rotation_is_left_out(session):
    alone = calibrate.calibrate_intrinsics(session, "brown")
    near, far = (maps.projection_uncertainty(alone, distance).values_px for distance in (0.3, 3.0))
    np.testing.assert_allclose(near, far, rtol=1e-6)
    assert near[13, 24] < alone.camera_std["cx"]  # most of the principal point is such a rotation


def test_files_that_keep_too_little_are_refused(rig):
    old = replace(rig, residuals=replace(rig.residuals, rig_correlation=None))
    with pytest.raises(UsageError, match="how its errors are correlated"):
        maps.projection_uncertainty(old, 0.4)
    with pytest.raises(UsageError, match="camera was given"):
        maps.projection_uncertainty(Calibration(rig.camera, {}), 0.4)
