"""Several targets before one camera: simulated sessions with true corners, noise on corners and on the arm's reports."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from koala3d.calib import calibrate
from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import KOALA
from koala3d.calib.errors import CalibrationError, Unobservable
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.targets.detection import Observation
from koala3d.calib.together.boards import Boards, calibrate_boards
from koala3d.datasets import pose
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.targets.board import Board

ARM = Accuracy(5e-5, float(np.deg2rad(0.01)))
PATTERN = ViewRange(tilt_deg=(0, 35), distance_m=(0.35, 0.5))
SMALL = Board.of("charuco", 7, 5, 0.02, 0.015, "DICT_4X4_100")
BESIDE = pose.from_rotation_vector([0.1, 0.3, 0.2], [0.05, -0.03, 0.02]) @ KOALA.base_from_board
"""Where the second target stands: tilted, and within the same pictures."""
TARGETS = ((KOALA.board, KOALA.base_from_board), (SMALL, BESIDE))


def simulated(
    seed: int, *, views: Sequence[int] = (14, 10), one_recording: bool = False, sigma_px: float = 0.1, arm: Accuracy = ARM
) -> list[TargetSession]:
    """A session of each target with so many views; in one recording they are of the same stops, with one error of the arm."""
    rng = np.random.default_rng([31, seed])
    found: list[TargetSession] = []
    for (board, base_from_board), count in zip(TARGETS, views, strict=True):
        if not (one_recording and found):
            true = viewpoints(rng, KOALA, count, PATTERN) @ pose.inverse(KOALA.flange_from_camera)
            errors = rng.normal(size=(count, 6)) * np.repeat([arm.translation_m, arm.rotation_rad], 3)
            reported = true @ pose.inverse(pose.from_rotation_vector(errors[:, 3:], errors[:, :3]))
        observations = []
        for index, flange in enumerate(true[:count]):
            camera_from_board = pose.inverse(flange @ KOALA.flange_from_camera) @ base_from_board
            pixels = KOALA.camera.project(board.points @ camera_from_board[:3, :3].T + camera_from_board[:3, 3])
            seen = np.flatnonzero(((pixels > 2) & (pixels < [KOALA.camera.width - 2, KOALA.camera.height - 2])).all(1))
            noisy = pixels[seen] + rng.normal(0, 1, (len(seen), 2)) * sigma_px
            observations.append(Observation(f"{index:03d}", seen, noisy, board.points[seen]))
        size = KOALA.camera.width, KOALA.camera.height
        found.append(TargetSession(board, *size, tuple(observations), reported[:count]))
    return found


def calibrated(sessions: list[TargetSession], one_recording: bool = False, **options) -> Boards:
    return calibrate_boards(sessions, ["big", "small"], ["first", "first" if one_recording else "second"], **options)


def twist(true: np.ndarray, found: np.ndarray) -> np.ndarray:
    """(6,) error of a pose."""
    motion = true @ pose.inverse(found)
    return np.concatenate([motion[:3, 3], pose.rotation_vector(motion[:3, :3])])


@pytest.fixture(scope="module")
def both() -> Boards:
    return calibrated(simulated(1))


def test_without_noise_the_truth_is_found() -> None:
    found = calibrated(simulated(2, sigma_px=1e-4, arm=Accuracy(1e-9, 1e-9)))
    np.testing.assert_allclose(found.calibration.flange_from_camera.matrix, KOALA.flange_from_camera, atol=1e-6)
    for placed, (_, base_from_board) in zip(found.stand_from_board, TARGETS, strict=True):
        np.testing.assert_allclose(placed.matrix, base_from_board, atol=1e-6)


def test_errors_are_within_what_is_stated(both) -> None:
    found = [both.calibration.flange_from_camera, *both.stand_from_board]
    for placed, true in zip(found, [KOALA.flange_from_camera, *(base_from_board for _, base_from_board in TARGETS)], strict=True):
        error = twist(true, placed.matrix)
        assert error @ np.linalg.solve(placed.covariance, error) < chi2.ppf(0.999, 6)


def test_two_targets_tell_at_least_what_their_mean_tells(both) -> None:
    """The weighted mean of two independent poses; together the two also share a lens. 2 %: sigmas are estimated anew."""
    alone, together = np.array([one.total_std for one in both.alone]), both.calibration.flange_from_camera.total_std
    assert (np.array(together) < 1.02 / np.sqrt((1 / alone**2).sum(0))).all()


def test_the_file_names_each_target_and_counts_them_all(both) -> None:
    residuals = both.calibration.residuals
    big, small = residuals.boards
    assert (big["name"], small["name"]) == ("big", "small") and (big["views"], small["views"]) == (14, 10)
    assert residuals.views_used == 24 and residuals.corners == big["corners"] + small["corners"]
    np.testing.assert_allclose(both.calibration.base_from_board.matrix, both.stand_from_board[0].matrix)
    assert 0.1 < residuals.held_out_px < residuals.held_out_all_px + 1e-9 < 1.0  # half a pixel is the arm's error
    assert both.calibration.provenance["method"] == "hand-eye, several targets"


def test_in_one_recording_a_stop_counts_once() -> None:
    """Both targets see the same error of the arm: as if the second were more corners of the first, no more views."""
    shared = calibrated(simulated(3, views=(12, 12), one_recording=True), one_recording=True)
    assert shared.calibration.residuals.views_used == 12
    error = twist(KOALA.flange_from_camera, shared.calibration.flange_from_camera.matrix)
    assert error @ np.linalg.solve(shared.calibration.flange_from_camera.covariance, error) < chi2.ppf(0.999, 6)


def test_a_target_in_two_views_helps_without_being_enough_alone() -> None:
    sessions = simulated(4, views=(12, 2))
    found = calibrated(sessions)
    assert found.alone[1] is None and found.alone[0] is not None
    assert found.calibration.residuals.boards[1]["views"] <= 2
    error = twist(BESIDE, found.stand_from_board[1].matrix)
    assert error @ np.linalg.solve(found.stand_from_board[1].covariance, error) < chi2.ppf(0.999, 6)
    with pytest.raises(Unobservable, match=r"no target alone determines .*\(2 sessions\)"):
        calibrated([_first_views(one, 4) for one in simulated(4)])


def _first_views(session: TargetSession, count: int) -> TargetSession:
    return session.chosen(np.arange(len(session.observations)) < count)


def test_a_camera_that_was_moved_is_named() -> None:
    big, small = simulated(5)
    moved = pose.from_rotation_vector([0.0, 0.0, 0.01], [0.003, 0.0, 0.0])
    small = replace(small, base_from_flange=small.base_from_flange @ moved)
    with pytest.raises(CalibrationError, match=r"camera was moved .*big and small put it .* mm and .* deg apart, where .*stated"):
        calibrated([big, small])


def test_sessions_that_do_not_belong_together_are_refused() -> None:
    big, small = simulated(6)
    with pytest.raises(UsageError, match=r"'calib handeye' is for \(1 session"):
        calibrate_boards([big], ["big"], ["first"])
    with pytest.raises(UsageError, match=r"small: pictures have another size.*960x540, those of big are 1920x1080"):
        calibrated([big, replace(small, width=960, height=540)])
    with pytest.raises(UsageError, match="small: one camera is on the flange and one beside"):
        calibrated([big, replace(small, eye_to_hand=True)])


def test_its_corners_do_not_count_again_in_a_session_that_it_was_made_from() -> None:
    sessions = [replace(one, provenance={"frames_sha256": name}) for one, name in zip(simulated(7), "ab", strict=True)]
    given = calibrated(sessions).calibration
    for session in sessions:
        assert calibrate.first_stage(session, given).known is None
    assert calibrate.first_stage(replace(sessions[0], provenance={"frames_sha256": "c"}), given).known is not None


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("one_recording", [True, False])
def test_errors_over_many_rigs_are_those_stated(one_recording: bool) -> None:
    """60 rigs: the mean squared distance over the six unknowns has a standard deviation of 7 %."""
    views = (12, 12) if one_recording else (12, 8)
    squared, gain = [], []
    for seed in range(60):
        found = calibrated(simulated(100 + seed, views=views, one_recording=one_recording), one_recording)
        placed = found.calibration.flange_from_camera
        error = twist(KOALA.flange_from_camera, placed.matrix)
        squared.append(error @ np.linalg.solve(placed.covariance, error) / 6)
        gain.append(placed.total_std[0] / min(one.total_std[0] for one in found.alone))
    print(
        f"\none recording {one_recording}: squared distance {np.mean(squared):.2f}, deviation {np.median(gain):.2f} of the best"
    )
    assert 0.8 < np.mean(squared) < 1.25
