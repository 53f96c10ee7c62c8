"""Pages show what the calibration file says, held against the recording."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.calib import calibrate
from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import ARM, KOALA, simulate, target_session
from koala3d.calib.handeye import refine
from koala3d.calib.intrinsics import estimate
from koala3d.calib.origin import recording_of
from koala3d.calib.page.evidence import ALONE, CORRECTED, REPORTED, CalibrationEvidence, gather
from koala3d.calib.page.view import ARROW, between_green_and_red, overall, with_arrows
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.targets.board import Board


@pytest.fixture(scope="module")
def session(observed) -> TargetSession:
    return observed


@pytest.fixture(scope="module")
def calibration(calibrated) -> Calibration:
    return calibrated


@pytest.fixture(scope="module")
def evidence(calibration, session) -> CalibrationEvidence:
    return gather(calibration, session)


def test_residuals_are_those_of_the_stored_calibration(evidence, calibration) -> None:
    assert tuple(evidence.residuals) == (CORRECTED, REPORTED) and evidence.notes == ()
    assert evidence.inliers.sum() == calibration.residuals.corners
    # the corrections alone are fitted, with the stored sigmas: they differ from those of the refinement in the last steps
    assert overall(evidence, CORRECTED) == pytest.approx(calibration.residuals.rms_px, rel=1e-4)
    assert overall(evidence, REPORTED) > 1.2 * overall(evidence, CORRECTED)
    for sighting in evidence.sightings():
        assert sighting.rms(CORRECTED) == pytest.approx(calibration.residuals.view_rms_px[sighting.name], rel=1e-3)


def test_nothing_is_estimated_again(session, calibration, monkeypatch) -> None:
    def refused(*arguments, **options):
        raise AssertionError("a page must not calibrate")

    monkeypatch.setattr(estimate, "calibrate", refused)
    monkeypatch.setattr(refine, "refine", refused)
    shifted = replace(calibration, camera=replace(calibration.camera, cx=calibration.camera.cx + 1))
    found = gather(shifted, session)
    assert found.calibration is shifted and overall(found, CORRECTED) > 1.2 * calibration.residuals.rms_px


def test_cameras_stand_where_they_truly_stood(evidence, recorded) -> None:
    _, truth = recorded
    for sighting in evidence.sightings():
        for place in (sighting.by_arm, sighting.by_picture):
            distance, angle = pose.difference(place, truth.taken[int(sighting.name)])
            assert distance < 1.5e-3 and angle < np.deg2rad(0.3)  # limit of one picture of 480 px; the arm errs by 0.05 mm


def test_every_view_has_its_image(evidence) -> None:
    for sighting in evidence.sightings():
        assert sighting.image is not None and sighting.image.name == f"{sighting.name}.png" and sighting.image.is_file()
    assert evidence.left_out == {"011": "no target was found"}


def test_a_camera_alone_has_its_own_residuals(calibration, session) -> None:
    found = gather(replace(calibration, flange_from_camera=None, base_from_board=None), session)
    assert tuple(found.residuals) == (ALONE,) and found.corrections is None and 0 < overall(found, ALONE) < 0.5
    assert all(np.array_equal(sighting.by_arm, sighting.by_picture) for sighting in found.sightings())


def test_views_left_out_are_shown_without_residuals(calibration, session) -> None:
    reasons = {"003": "arm and picture disagree"}
    facts = replace(calibration.residuals, views_left_out=["003"], why_left_out=reasons)
    found = gather(replace(calibration, residuals=facts), session)
    shown = {sighting.name: sighting for sighting in found.sightings()}
    assert shown["003"].left_out == "arm and picture disagree" and shown["003"].residuals == {}
    assert len(found.session.observations) == 10 and shown["004"].left_out == ""


def test_another_recording_is_named_as_such(calibration, session) -> None:
    other = replace(calibration, provenance={**calibration.provenance, "frames_sha256": "0"})
    assert "not the recording" in gather(other, session).notes[0]


def test_an_ambiguous_board_is_read_as_the_calibration_has_it() -> None:
    rig, rng = replace(KOALA, board=Board.of("chessboard", 9, 7, 0.03)), np.random.default_rng(4)
    simulated = simulate(rng, rig, viewpoints(rng, rig, 12, ViewRange()), sigma_px=0.1, arm=ARM)
    session = target_session(simulated)
    found = calibrate.calibrate_handeye(session, accuracy=ARM)
    last = len(rig.board.points) - 1
    turned = [replace(o, ids=last - o.ids, points=rig.board.points[last - o.ids]) for o in session.observations[::2]]
    mixed = [turned[i // 2] if i % 2 == 0 else o for i, o in enumerate(session.observations)]
    evidence = gather(found, replace(session, observations=tuple(mixed)))
    assert overall(evidence, CORRECTED) == pytest.approx(found.residuals.rms_px, rel=1e-3)


def test_a_missing_recording_is_named(calibration, recorded, tmp_path: Path) -> None:
    assert recording_of(calibration, None) == recorded[0].resolve()
    with pytest.raises(UsageError, match=r"gone.*--recording"):
        recording_of(calibration, tmp_path / "gone")
    with pytest.raises(UsageError, match="--recording"):
        recording_of(replace(calibration, provenance={}), None)


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
