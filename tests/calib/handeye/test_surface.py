"""A stretched and bent target: derivatives, the truth is found, and what ignoring it costs."""

from dataclasses import replace

import numpy as np
import pytest

from koala3d.calib import calibrate
from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import KOALA, simulate
from koala3d.calib.handeye import model, surface
from koala3d.calib.handeye.model import Accuracy, State
from koala3d.calib.intrinsics import projection
from koala3d.calib.options import Arm, Inexact
from koala3d.calib.page.summary import describe_calibration
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.residuals import Residuals

SHAPE = np.array([0.002, -0.001, 8e-4, -3e-4])
"""Paper that a printer pulled by 0.2 %, glued to a plate that sags by 0.8 mm."""
ARM = Accuracy(5e-5, float(np.deg2rad(0.01)))
TOLERANT = replace(ARM, stretch=0.005, sag_m=2e-3)
BOARD = KOALA.board
EXTENT = surface.extent_of(BOARD.points)


def bent(seed: int, shape: np.ndarray = SHAPE, views: int = 20) -> TargetSession:
    """A session whose target has that shape, and whose corners are named by where they should be."""
    rng = np.random.default_rng([14, seed])
    truly = BOARD.points + surface.by_shape(BOARD.points, EXTENT) @ shape
    drawn = simulate(rng, KOALA, viewpoints(rng, KOALA, views, ViewRange()), sigma_px=0.1, arm=ARM, printed=truly)
    camera = KOALA.camera
    return TargetSession(BOARD, camera.width, camera.height, tuple(drawn.observations()), drawn.session.base_from_flange)


def error_mm(found: Calibration) -> float:
    return 1e3 * float(np.linalg.norm((found.flange_from_camera.matrix - KOALA.flange_from_camera)[:3, 3]))


def test_a_corner_is_where_the_equation_says() -> None:
    corner, middle = BOARD.points[[0]], np.append(EXTENT.mean(0), 0.0)[None]
    at_corner, at_middle = (one + surface.by_shape(one, EXTENT) @ SHAPE for one in (corner, middle))
    np.testing.assert_allclose(at_corner[0], corner[0] * [1.002, 0.999, 1])
    np.testing.assert_allclose(at_middle[0], [*(middle[0, :2] * [1.002, 0.999]), 5e-4])


def test_derivatives_agree_with_central_differences() -> None:
    session = model.measured(bent(0, views=4), ("fx", "k1"), None, TOLERANT)
    start = State(
        projection.vector(KOALA.camera), KOALA.flange_from_camera, KOALA.base_from_board, np.full((4, 6), 1e-4), shape=SHAPE
    )
    _, by_global, _ = model.predict(session, start)
    still, width, step = np.zeros((4, 6)), by_global.shape[-1], 1e-6
    assert width == 2 + 4 + 12
    for unknown in range(width):
        ahead, behind = (
            model.predict(session, session.moved(start, sign * step * np.eye(width)[unknown], still))[0] for sign in (1, -1)
        )
        np.testing.assert_allclose(
            by_global[..., unknown], (ahead - behind) / (2 * step), rtol=1e-5, atol=1e-2
        )  # px/m: thousands


@pytest.fixture(scope="module")
def found() -> Calibration:
    return calibrate.calibrate_handeye(bent(1), accuracy=TOLERANT)


def test_the_shape_is_found_within_what_is_stated(found) -> None:
    shape, std = (np.array(getattr(found.residuals, name)) for name in ("target_shape", "target_shape_std"))
    assert (np.abs(shape - SHAPE) < 4 * std).all()
    assert (std < 0.1 * np.array([0.005, 0.005, 2e-3, 2e-3])).all(), "the views say ten times as much as was stated"
    assert "stretched by 0." in describe_calibration(found) and "deeper than its edges" in describe_calibration(found)


def test_who_takes_it_for_flat_pays(found) -> None:
    flat = calibrate.calibrate_handeye(bent(1), accuracy=ARM)
    assert error_mm(found) < 4 * found.flange_from_camera.total_std[0]
    assert flat.residuals.rms_px > 1.3 * found.residuals.rms_px
    assert error_mm(flat) > 2 * error_mm(found)
    assert "fit a target that is stretched" in describe_calibration(flat) and "--sag-mm 2" in describe_calibration(flat)


@pytest.mark.parametrize("seed", range(3))
def test_a_flat_target_is_not_suspected(seed) -> None:
    assert calibrate.calibrate_handeye(bent(seed, np.zeros(4)), accuracy=ARM).residuals.target_seems is None


def test_a_flat_target_loses_little() -> None:
    session = bent(2, np.zeros(4))
    tolerant, plain = (calibrate.calibrate_handeye(session, accuracy=one) for one in (TOLERANT, ARM))
    assert tolerant.flange_from_camera.total_std[0] < 1.5 * plain.flange_from_camera.total_std[0]
    assert (np.abs(tolerant.residuals.target_shape) < 4 * np.array(tolerant.residuals.target_shape_std)).all()


def test_only_what_is_asked_for_is_estimated() -> None:
    shape_of = lambda accuracy: model.measured(bent(3, views=5), ("fx",), None, accuracy).shaped  # noqa: E731
    assert shape_of(ARM) == [] and shape_of(replace(ARM, sag_m=1e-3)) == [2, 3] and shape_of(TOLERANT) == [0, 1, 2, 3]


def test_a_file_without_a_credible_shape_is_of_a_flat_target() -> None:
    for stored in (Residuals(), Residuals(target_shape=[1, 2]), Residuals(target_shape=[np.nan] * 4)):
        np.testing.assert_array_equal(surface.known(stored), np.zeros(4))
    assert surface.in_words(Residuals()) == ""


def test_options_that_are_no_accuracy_are_refused() -> None:
    with pytest.raises(UsageError, match=r"--sag-mm: accuracy must be a positive number .-1 given"):
        Arm().accuracy(Inexact(sag_mm=-1))
    assert Arm().accuracy(Inexact(print_percent=0.5, sag_mm=2)) == replace(TOLERANT, joint_rad=0.0)


def test_the_pose_of_the_target_does_not_hide_it(found) -> None:
    assert np.linalg.norm(found.base_from_board.matrix[:3, 3] - KOALA.base_from_board[:3, 3]) < 5e-4
    assert np.linalg.norm(pose.rotation_vector(found.base_from_board.matrix[:3, :3] @ KOALA.base_from_board[:3, :3].T)) < 2e-3
