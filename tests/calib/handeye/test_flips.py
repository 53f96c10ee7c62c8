from dataclasses import replace

import numpy as np
import pytest

from koala3d.calib import calibrate
from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import KOALA, simulate, target_session
from koala3d.calib.handeye import flips
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.intrinsics import estimate
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets import pose
from koala3d.datasets.targets.board import Board

ARM = Accuracy(1e-4, float(np.deg2rad(0.02)))
AMBIGUOUS = replace(KOALA, board=Board.of("chessboard", 9, 7, 0.03))


def spoilt(seed, roll=(-180.0, 180.0)):
    """(simulated, session in which every second view is read upside down, which)."""
    rng = np.random.default_rng([4, seed])
    simulated = simulate(rng, AMBIGUOUS, viewpoints(rng, AMBIGUOUS, 14, ViewRange(roll_deg=roll)), sigma_px=0.1, arm=ARM)
    session, turned = target_session(simulated), rng.random(14) < 0.5
    points = AMBIGUOUS.board.points
    last = len(points) - 1
    observations = [
        replace(o, ids=last - o.ids, points=points[last - o.ids]) if t else o
        for o, t in zip(session.observations, turned, strict=True)
    ]
    return simulated, replace(session, observations=tuple(observations)), turned


@pytest.mark.parametrize("seed", range(4))
def test_views_are_read_the_same_way_round(seed):
    simulated, session, turned = spoilt(seed, (-180.0, 180.0) if seed % 2 else (-20.0, 20.0))
    boards = estimate.camera_from_boards(simulated.rig.camera, session.observations)
    resolved, poses = flips.resolve(session, boards)
    again = np.array(
        [not np.allclose(a.points, b.points) for a, b in zip(session.observations, resolved.observations, strict=True)]
    )
    assert (again == turned).all() or (again == ~turned).all()  # which way is the first one nobody can tell
    expected = estimate.camera_from_boards(simulated.rig.camera, resolved.observations)
    np.testing.assert_allclose(poses, expected, atol=1e-6)


def test_hand_eye_of_an_ambiguous_board_is_right():
    simulated, session, _ = spoilt(9)
    found = calibrate.calibrate_handeye(session, accuracy=ARM)
    distance, angle = pose.difference(found.flange_from_camera.matrix, simulated.truth.mount_from_camera)
    assert distance < 4e-4 and np.rad2deg(angle) < 0.08  # five times the stated deviation
    assert found.residuals.views_left_out == []


def test_half_a_turn_maps_the_board_to_itself():
    session = spoilt(0)[1]
    points = AMBIGUOUS.board.points
    turned = points @ flips.half_turn(session)[:3, :3].T + flips.half_turn(session)[:3, 3]
    np.testing.assert_allclose(turned, points[::-1], atol=1e-12)


def test_other_boards_are_left_alone(simulate):
    simulated = simulate(seed=3, views=8)
    session = TargetSession(simulated.board, 960, 600, tuple(simulated.observations), simulated.reported)
    boards = estimate.camera_from_boards(simulated.camera, session.observations)
    assert flips.resolve(session, boards)[0] is session
