"""Errors of the links of arms that are no UR5e: their own links, as many offsets as they have joints between first and last."""

from dataclasses import replace

import numpy as np
import pytest

from koala3d.calib import calibrate
from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import KOALA
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import links, model, uncertainty
from koala3d.calib.handeye.model import Accuracy, State
from koala3d.calib.intrinsics import projection
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.targets.detection import Observation
from koala3d.capture.model.arm import ArmModel, load_arm
from koala3d.datasets import kinematics, pose
from koala3d.datasets.calibration import Calibration, LinkErrors
from koala3d.datasets.targets.board import Board

RIG = replace(KOALA, board=Board.of("charuco", 12, 9, 0.03, 0.022))
ARM = Accuracy(3e-5, float(np.deg2rad(0.005)), float(np.deg2rad(0.05)))


def simulated(arm: ArmModel, offsets: np.ndarray, views: int, seed: int = 0, noise: float = 1.0) -> TargetSession:
    """An arm as built that looks at the board; it reports what its links give for the angles that it believes in."""
    rng, angles = np.random.default_rng([9, seed]), []
    while len(angles) < views:
        camera = viewpoints(rng, RIG, 1, ViewRange((5.0, 40.0)))[0]
        branches = arm.inverse(camera @ pose.inverse(RIG.flange_from_camera))
        branches = branches[arm.inside(branches)]
        if len(branches):
            angles.append(branches[rng.integers(len(branches))])
    built = arm.links.calibrated(np.random.default_rng(5), 3e-4, 3e-4)
    observations = []
    for index, flange in enumerate(kinematics.forward(np.array(angles) + offsets, built)):
        camera_from_board = pose.inverse(flange @ RIG.flange_from_camera) @ RIG.base_from_board
        pixels = RIG.camera.project(RIG.board.points @ camera_from_board[:3, :3].T + camera_from_board[:3, 3])
        ids = np.flatnonzero(((pixels > 2) & (pixels < [RIG.camera.width - 2, RIG.camera.height - 2])).all(1))
        seen = pixels[ids] + 0.1 * noise * rng.normal(size=(len(ids), 2))
        observations.append(Observation(f"{index:03d}", ids, seen, RIG.board.points[ids]))
    reported = kinematics.forward(np.array(angles), built)
    size = RIG.camera.width, RIG.camera.height
    return TargetSession(
        RIG.board,
        *size,
        tuple(observations),
        reported,
        provenance={"frames_sha256": "0"},
        joints=np.array(angles),
        links=arm.links,
    )


@pytest.mark.parametrize("name", ["ur10e", "panda"])
def test_jacobian_agrees_with_central_differences(name: str) -> None:
    arm = load_arm(name)
    session, rng = simulated(arm, np.zeros(arm.count), 4), np.random.default_rng(3)
    measured = model.measured(session, ("fx",), None, ARM)
    assert measured.erring == list(range(3 * arm.count + 1, 4 * arm.count - 1))
    corrections = rng.normal(0, 1, (4, 6)) * np.repeat([0.01, 0.1], 3)
    offsets = np.concatenate([np.zeros(3 * arm.count + 1), rng.normal(0, 0.02, arm.count - 2), [0]])
    state = State(projection.vector(RIG.camera), RIG.flange_from_camera, RIG.base_from_board, corrections, offsets)
    _, by_global, _ = model.predict(measured, state)
    count = 1 + arm.count - 2 + 12
    assert by_global.shape[-1] == count == len(uncertainty.parameter_names(measured))
    for index in range(count):
        step = 1e-6 * np.eye(count)[index]
        ahead, behind = (model.predict(measured, measured.moved(state, s * step, np.zeros((4, 6))))[0] for s in (1, -1))
        np.testing.assert_allclose(by_global[..., index], (ahead - behind) / 2e-6, rtol=1e-5, atol=2e-3)


@pytest.mark.parametrize("name", ["ur10e", "panda"])
def test_offsets_come_out_within_their_deviations(name: str) -> None:
    arm = load_arm(name)
    offsets = np.deg2rad([0, 0.05, -0.04, 0.06, -0.05, 0.04, 0][: arm.count])
    offsets[-1] = 0
    session = simulated(arm, offsets, 25)
    found = calibrate.calibrate_handeye(session, Calibration(RIG.camera, {}), ARM)
    inner = slice(1, arm.count - 1)
    assert found.link_errors is not None
    joints, std = found.link_errors.joints
    assert joints.shape == (arm.count,)
    off = (joints - offsets)[inner] / std[inner]
    assert np.abs(off).max() < 4
    assert found.residuals.held_out_px < 0.8 * found.residuals.held_out_px_without_link_errors
    corrected = found.camera_pose(session.base_from_flange, session.joints)
    errors = np.concatenate([np.zeros(3 * arm.count), offsets])
    truth = kinematics.corrected(session.base_from_flange, session.joints, errors, arm.links) @ RIG.flange_from_camera
    assert np.median(pose.difference(corrected, truth)[0]) < 5e-4


def test_the_links_of_another_arm_are_refused() -> None:
    session = simulated(load_arm("ur10e"), np.zeros(6), 4)
    links.check(session, ARM)
    with pytest.raises(CalibrationError, match="by the kinematics of the arm's model the flange is"):
        links.check(replace(session, links=load_arm("ur5e").links), ARM)


def test_stored_offsets_keep_their_arm(tmp_path) -> None:
    arm = load_arm("panda")
    errors = LinkErrors(np.repeat([0.0, 1e-3], [21, 7]), np.repeat([0.0, 1e-4], [21, 7]), arm.links)
    again = LinkErrors.from_json(errors.to_json(), where="here")
    assert again.only_joints
    reported = arm.forward(arm.home)
    np.testing.assert_allclose(again.corrected(reported, arm.home), arm.forward(arm.home + 1e-3), atol=1e-12)
