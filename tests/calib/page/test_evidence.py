"""What the page of a calibration shows is what the calibration found."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib import calibrate
from calib.page.evidence import AFTER, ALONE, BEFORE, gather, recording_of
from calib.page.view import ARROW, between_green_and_red, decoded, overall, with_arrows
from calib.sessions.session import observe_recording
from datasets import pose
from datasets.calibration import Calibration
from datasets.core.errors import UsageError


@pytest.fixture(scope="module")
def calibrated(recorded) -> tuple[Path, Calibration]:
    path, _ = recorded
    return path, calibrate.calibrate_handeye(observe_recording(path))


@pytest.fixture(scope="module")
def evidence(calibrated):
    path, calibration = calibrated
    return gather(calibration, path)


def test_residuals_are_those_of_the_calibration_and_larger_before_it(evidence, calibrated) -> None:
    _, calibration = calibrated
    assert evidence.stages == (AFTER, BEFORE) and evidence.notes == ()
    assert overall(evidence, AFTER) == pytest.approx(
        calibration.residuals["rms_px"], rel=1e-6
    )  # the same fit of the same corners
    assert overall(evidence, BEFORE) > 1.2 * overall(evidence, AFTER)
    for sighting in evidence.sightings:
        assert sighting.rms(AFTER) == pytest.approx(calibration.residuals["view_rms_px"][sighting.name], rel=1e-6)


def test_cameras_stand_where_they_truly_stood(evidence, recorded) -> None:
    _, truth = recorded
    for sighting in evidence.sightings:
        for place in (sighting.by_arm, sighting.by_picture):
            distance, angle = pose.difference(place, truth.taken[int(sighting.name)])
            assert distance < 1.5e-3 and angle < np.deg2rad(0.3)  # one picture of 480 px says no more; the arm errs by 0.05 mm


def test_every_view_has_its_picture_and_figures_are_pictures(evidence) -> None:
    assert all(sighting.image.name == f"{sighting.name}.png" and sighting.image.is_file() for sighting in evidence.sightings)
    assert {"coverage", "errors by view", f"residuals {AFTER}", f"residuals {BEFORE}"} <= set(evidence.pictures)
    assert all(min(decoded(png).shape[:2]) > 200 for png in evidence.pictures.values())


def test_a_camera_alone_has_its_own_residuals(calibrated) -> None:
    path, calibration = calibrated
    found = gather(replace(calibration, flange_from_camera=None, base_from_board=None), path)
    assert found.stages == (ALONE,) and 0 < overall(found, ALONE) < 0.5


def test_another_recording_is_said_to_be_another(calibrated) -> None:
    path, calibration = calibrated
    other = replace(calibration, provenance={**calibration.provenance, "frames_sha256": "0"})
    assert "not the recording" in gather(other, path).notes[0]


def test_a_recording_that_is_gone_is_named(calibrated, tmp_path: Path) -> None:
    path, calibration = calibrated
    assert recording_of(calibration, None) == path.resolve()
    with pytest.raises(UsageError, match="--recording"):
        recording_of(calibration, tmp_path)


def test_arrows_lead_from_where_a_corner_was_seen_the_way_it_is_off() -> None:
    picture = np.zeros((200, 320, 3), np.float32)
    drawn, enlarged = with_arrows(picture, np.array([[100.0, 100.0]]), np.array([[0.02, 0.0]]))
    assert enlarged == pytest.approx(ARROW * 320 / 0.02)
    rows, columns = np.nonzero(drawn[..., 0] > 200)  # red
    assert (
        drawn.shape == (400, 640, 3) and abs(rows.mean() - 200) < 3 and columns.max() == pytest.approx(200 + ARROW * 640, abs=3)
    )
    rings, none = with_arrows(picture, np.array([[100.0, 100.0]]), None)
    assert none == 0 and not (rings[..., 0] > 200).any() and rings.any()


def test_colours_go_from_green_to_red() -> None:
    good, middle, bad = (between_green_and_red(share) for share in (0.0, 0.5, 1.0))
    assert good[1] > good[0] and bad[0] > bad[1] and min(middle[:2]) >= 180
