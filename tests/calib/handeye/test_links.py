"""An arm whose links are not as it thinks: a UR5e above a board on the table."""

from dataclasses import replace

import numpy as np
import pytest

from koala3d.calib import calibrate
from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import KOALA
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import links, model, uncertainty, verify
from koala3d.calib.handeye.model import Accuracy, State
from koala3d.calib.intrinsics import projection
from koala3d.calib.page import summary
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.targets.detection import Observation
from koala3d.capture.model.arm import load_arm
from koala3d.datasets import kinematics, pose
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.targets.board import Board

RIG = replace(KOALA, board=Board.of("charuco", 12, 9, 0.03, 0.022))
OFFSETS = np.deg2rad([0.0, 0.05, -0.06, 0.04, -0.03, 0.0])
ARM = Accuracy(3e-5, float(np.deg2rad(0.005)), float(np.deg2rad(0.05)))
BUILT = kinematics.UR5E.calibrated(np.random.default_rng(1), 5e-4, 5e-4)
"""The arm as built: half a millimetre and half a milliradian off the drawing in every parameter."""


def reached(seed, views):
    """(views, 6) joint angles with which the nominal arm looks at the board from many sides."""
    rng, pattern = np.random.default_rng([8, seed]), ViewRange((5.0, 40.0))
    found = []
    while len(found) < views:
        camera = viewpoints(rng, RIG, 1, pattern)[0]
        branches = load_arm("ur5e").inverse(camera @ pose.inverse(RIG.flange_from_camera))
        if len(branches):
            found.append(branches[rng.integers(len(branches))])
    return np.array(found)


def simulated(seed, views=25, offsets=OFFSETS, built=BUILT, noise=1.0, angles=None, reported=None):
    """A session of that arm; it reports what `reported` links, or its own, give for the joint angles that it believes in."""
    rng, angles = np.random.default_rng([7, seed]), reached(seed, views) if angles is None else angles
    errors = noise * rng.normal(size=(views, 6)) * np.repeat([ARM.translation_m, ARM.rotation_rad], 3)
    true = kinematics.forward(angles + offsets, built) @ pose.from_rotation_vector(errors[:, 3:], errors[:, :3])
    observations = []
    for index, flange in enumerate(true):
        camera_from_board = pose.inverse(flange @ RIG.flange_from_camera) @ RIG.base_from_board
        pixels = RIG.camera.project(RIG.board.points @ camera_from_board[:3, :3].T + camera_from_board[:3, 3])
        ids = np.flatnonzero(((pixels > 2) & (pixels < [RIG.camera.width - 2, RIG.camera.height - 2])).all(1))
        seen = pixels[ids] + 0.1 * noise * rng.normal(size=(len(ids), 2))
        observations.append(Observation(f"{index:03d}", ids, seen, RIG.board.points[ids]))
    return TargetSession(
        RIG.board,
        RIG.camera.width,
        RIG.camera.height,
        tuple(observations),
        kinematics.forward(angles, built if reported is None else reported),
        provenance={"frames_sha256": f"{seed}"},
        joints=angles,
    )


def calibrated(session, accuracy=ARM):
    """With the camera known, which saves half the time."""
    return calibrate.calibrate_handeye(session, Calibration(RIG.camera, {}), accuracy)


def joint_errors(offsets):
    """Errors of the links that are offsets of the joints."""
    return np.concatenate([np.zeros(18), offsets])


def hand_eye_error(found):
    """(2,) [mm], [deg]."""
    distance, angle = pose.difference(found.flange_from_camera.matrix, RIG.flange_from_camera)
    return np.array([1e3 * distance, np.rad2deg(angle)])


@pytest.mark.parametrize("eye_to_hand", [False, True])
def test_jacobian_agrees_with_central_differences(eye_to_hand):
    session = replace(simulated(0, views=4), eye_to_hand=eye_to_hand)
    measured = model.measured(session, ("fx",), None, ARM)
    rng = np.random.default_rng(3)
    corrections = rng.normal(0, 1, (4, 6)) * np.repeat([0.01, 0.1], 3)  # large: no term of the derivative is nearly zero
    state = State(
        projection.vector(RIG.camera), RIG.flange_from_camera, RIG.base_from_board, corrections, 30 * joint_errors(OFFSETS)
    )
    if eye_to_hand:  # the board on the flange, the camera where it sees every view
        flange = session.base_from_flange[0]
        state = replace(
            state, mount_from_camera=flange @ pose.from_rotation_vector([np.pi, 0, 0], [0, 0, 2]), stand_from_board=np.eye(4)
        )
    _, by_global, _ = model.predict(measured, state)
    assert by_global.shape[-1] == 1 + 4 + 12
    for index in range(17):
        step = 1e-6 * np.eye(17)[index]
        ahead, behind = (model.predict(measured, measured.moved(state, s * step, np.zeros((4, 6))))[0] for s in (1, -1))
        np.testing.assert_allclose(by_global[..., index], (ahead - behind) / 2e-6, rtol=1e-5, atol=2e-3)


@pytest.mark.parametrize("eye_to_hand", [False, True])
def test_derivatives_by_all_parameters_agree_with_central_differences(eye_to_hand):
    session = replace(simulated(0, views=4), eye_to_hand=eye_to_hand)
    measured = model.measured(session, (), None, Accuracy(length_m=5e-4, angle_rad=5e-4))
    rng = np.random.default_rng(3)
    corrections, errors = rng.normal(0, 1, (4, 6)) * np.repeat([0.01, 0.1], 3), 0.01 * rng.normal(size=24)
    state = State(projection.vector(RIG.camera), RIG.flange_from_camera, RIG.base_from_board, corrections, errors)
    if eye_to_hand:
        flange = session.base_from_flange[0]
        state = replace(
            state, mount_from_camera=flange @ pose.from_rotation_vector([np.pi, 0, 0], [0, 0, 2]), stand_from_board=np.eye(4)
        )
    assert len(measured.erring) == 18  # all but d and theta of the first link, and all of the last
    _, by_global, _ = model.predict(measured, state)
    for index in range(18):
        step = 1e-6 * np.eye(30)[index]
        ahead, behind = (model.predict(measured, measured.moved(state, s * step, np.zeros((4, 6))))[0] for s in (1, -1))
        np.testing.assert_allclose(by_global[..., index], (ahead - behind) / 2e-6, rtol=1e-5, atol=5e-3)


def test_links_that_were_built_otherwise_are_found_and_unseen_views_predicted():
    """An arm that reports by its drawing: with errors of all links estimated, as good as one that knows itself."""
    session = simulated(80, 30, np.zeros(6), reported=kinematics.UR5E)
    found = calibrated(session, replace(ARM, joint_rad=0.0, length_m=5e-4, angle_rad=5e-4))
    assert found.residuals.held_out_mm < 0.3 * found.residuals.held_out_mm_without_link_errors
    assert "d of link 2" in found.residuals.links_not_shown  # d of links 2, 3 and 4 lie along parallel axes
    shown = found.link_errors.std < links.SHOWN * np.repeat(5e-4, 24)
    assert shown[found.link_errors.std > 0].sum() >= 8 and not found.link_errors.only_joints
    text = summary.describe_calibration(found)
    assert "links, alpha" in text and "off by" in text
    # the true links but those that are zero by convention: these move base and flange
    camera = kinematics.corrected(session.base_from_flange, session.joints, found.link_errors.errors)
    true = kinematics.forward(session.joints, BUILT) @ RIG.flange_from_camera
    seen = camera @ found.flange_from_camera.matrix
    moved = seen @ pose.inverse(true)
    distance, _ = pose.difference(moved, moved[0])
    assert np.median(distance) < 3e-4


def test_first_and_last_joint_are_taken_up_by_the_two_poses():
    """The convention that their offsets are zero loses nothing: the pictures cannot tell."""
    first, last = 0.005, -0.003
    session = simulated(1, 8, np.array([first, 0, 0, 0, 0, last]), kinematics.UR5E, noise=0.0)
    state = State(
        projection.vector(RIG.camera),
        pose.from_rotation_vector([0, 0, last]) @ RIG.flange_from_camera,
        pose.from_rotation_vector([0, 0, -first]) @ RIG.base_from_board,
        np.zeros((8, 6)),
    )
    measured = model.measured(session, (), None, ARM)
    np.testing.assert_allclose(model.predict(measured, state)[0], measured.pixels, atol=1e-8)


def test_offsets_come_out_within_their_deviations_and_the_rig_with_them():
    off, errors = [], {True: [], False: []}
    for seed in range(2):
        session = simulated(10 + seed)
        for asked in (True, False):
            found = calibrated(session, ARM if asked else replace(ARM, joint_rad=0.0))
            errors[asked].append(hand_eye_error(found))
            if asked:
                offsets, std = found.link_errors.joints
                off.append((offsets - OFFSETS)[1:5] / std[1:5])
                assert found.residuals.held_out_px < 0.6 * found.residuals.held_out_px_without_link_errors
                assert offsets[0] == offsets[5] == 0 and found.residuals.links_not_shown == []
                assert found.link_errors.only_joints
            else:
                assert found.link_errors is None
    assert np.abs(off).max() < 4  # eight numbers of unit variance
    # offsets of a twentieth of a degree move the flange by half a millimetre; without them the hand-eye pose pays for it
    assert (3 * np.median(errors[True], axis=0) < np.median(errors[False], axis=0)).all(), errors


def test_stated_region_holds_the_hand_eye_pose():
    """Offsets cost certainty, and the covariance knows."""
    session = simulated(20)
    found = calibrated(session)
    perturbation = RIG.flange_from_camera @ pose.inverse(found.flange_from_camera.matrix)
    error = np.concatenate([perturbation[:3, 3], pose.rotation_vector(perturbation)])
    assert error @ np.linalg.solve(found.flange_from_camera.covariance, error) < 30  # chi-square of 6: once in 25000


def test_an_honest_arm_is_told_so():
    session = simulated(30, offsets=np.zeros(6))
    found = calibrated(session)
    offsets, std = found.link_errors.joints
    assert (np.abs(offsets[1:5]) < 4 * std[1:5]).all()
    assert found.residuals.held_out_px > 0.95 * found.residuals.held_out_px_without_link_errors


def test_offsets_that_no_view_shows_stay_at_their_prior():
    """Where the wrist alone turns, the axes of the joints before it hold still: their offsets are a motion of the board."""
    rng, angles = np.random.default_rng(4), np.repeat(reached(60, 1), 15, axis=0)
    angles[:, 3:] += rng.normal(0, 0.15, (15, 3))
    found = calibrated(simulated(60, 15, angles=angles))
    assert found.residuals.links_not_shown == [f"offset of joint {number}" for number in (2, 3, 4)]
    _, std = found.link_errors.joints
    np.testing.assert_allclose(std[1:4], ARM.joint_rad, rtol=0.05)
    assert std[4] < 0.5 * ARM.joint_rad
    assert any("do not determine offset of joint 2, offset of joint 3" in note for note in summary.notes(found))


def test_parameters_are_named_in_their_order():
    measured = model.measured(simulated(70, 4), ("fx",), None, ARM)
    assert uncertainty.parameter_names(measured)[:6] == [
        "fx",
        *(f"offset of joint {number}" for number in (2, 3, 4, 5)),
        "flange_from_camera translation x",
    ]


def test_verification_applies_them():
    found = calibrated(simulated(40))
    other = simulated(41, views=12)
    right, wrong = verify.verify(other, found), verify.verify(other, replace(found, link_errors=None))
    assert right.rms_mm < 0.1 and wrong.rms_mm > 2 * right.rms_mm
    with pytest.raises(UsageError, match="no joint angles"):
        verify.verify(replace(other, joints=None), found)


def test_missing_and_foreign_joint_angles_are_refused():
    session = simulated(50, views=8)
    with pytest.raises(CalibrationError, match="holds no joint angles"):
        links.check(replace(session, joints=None), ARM)
    with pytest.raises(CalibrationError, match="not those of the poses"):
        links.check(replace(session, joints=np.zeros((8, 6))), ARM)
    links.check(replace(session, joints=None), replace(ARM, joint_rad=0.0))
    assert Calibration(RIG.camera, {}).link_errors is None


@pytest.mark.slow
@pytest.mark.parametrize(("off", "gained"), [(0.0, 1.15), (1.0, 0.15)])
def test_unseen_views_over_ten_arms(off, gained):
    """An exact arm loses little by the estimate; one that is off by what is stated is as good as exact."""
    without, with_errors = [], []
    for seed in range(10):
        built = kinematics.UR5E.calibrated(np.random.default_rng([seed, 9]), off * 5e-4, off * np.deg2rad(0.05))
        session = simulated(500 + seed, 25, np.zeros(6), built=built, reported=kinematics.UR5E)
        found = calibrated(session, replace(ARM, joint_rad=0.0, length_m=5e-4, angle_rad=float(np.deg2rad(0.05))))
        without.append(found.residuals.held_out_mm_without_link_errors)
        with_errors.append(found.residuals.held_out_mm)
    print(f"\nlinks off by {0.5 * off} mm: {np.median(without):.3f} mm as reported, {np.median(with_errors):.3f} mm with errors")
    assert np.median(with_errors) < gained * np.median(without)
