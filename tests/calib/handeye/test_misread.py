"""Angles of sessions that SciPy writes in one way and a description reads in another."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from koala3d.calib.calibrate import calibrate_handeye
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import flips, misread
from koala3d.calib.intrinsics import estimate
from koala3d.calib.sessions.description import SEQUENCES, Description
from koala3d.calib.sessions.layouts import as_pose, other_readings
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets import pose
from koala3d.datasets.targets.board import Board


@pytest.fixture(scope="module")
def simulated(simulate):
    """A session, the poses of the board in it, and the arm's poses in a base in which its angles are large."""
    found = simulate(seed=83, views=12)
    return found, estimate.camera_from_boards(found.camera, found.observations), found.reported


def as_read(simulated, written, read, unit="deg", base=None, **said):
    """The session if its poses are written as Euler angles `written` (or as rotation vectors) and described as `read`."""
    found, boards, reported = simulated
    poses = reported if base is None else base @ reported
    turns = Rotation.from_matrix(poses[:, :3, :3])
    angles = turns.as_euler(written, degrees=unit == "deg") if written else turns.as_rotvec(degrees=unit == "deg")
    content = {"images": "*.png", "poses": "a.csv", "layout": "x y z rx ry rz", "board": found.board.to_json(), "euler": read}
    description = Description(**{**content, "angle": unit, **said})
    rows = np.hstack([poses[:, :3, 3], angles])
    taken = np.stack([as_pose(row, description, where="") for row in rows])
    session = TargetSession(found.board, 960, 600, tuple(found.observations), taken, readings=other_readings(rows, description))
    return session, boards


@pytest.mark.parametrize("unit", ["deg", "rad"])
@pytest.mark.parametrize("written", ["xyz", "ZYX", "ZYZ", "XYZ", "zxy", "YXY"])
def test_euler_angles_read_as_a_rotation_vector_are_named(simulated, written, unit):
    found = misread.recognise(*as_read(simulated, written, "", unit))
    assert found is not None and found.description == f"euler: {written} and angle: {unit}"


@pytest.mark.parametrize("read", [sequence for sequence in SEQUENCES if sequence not in ("", "ZYX")])
def test_any_sequence_read_as_another_is_named(simulated, read):
    found = misread.recognise(*as_read(simulated, "ZYX", read))
    assert found is not None and found.kind == "Euler angles ZYX in degrees"


def test_small_angles_are_told_apart(simulate, make_viewpoints):
    """In a base in which the angles are small, poses are wrong by a few degrees."""
    found = simulate(seed=84, poses=lambda rng: make_viewpoints(rng, 14, tilt_deg=25))
    near = (found, estimate.camera_from_boards(found.camera, found.observations), found.reported)
    apart = np.median([pose.rotation_angle(pose.inverse(one) @ found.reported) for one in found.reported], axis=1)
    base = pose.rigid(found.reported[apart.argmin()][:3, :3].T, [0, 0, 0])
    for written in ("xyz", "XYZ"):
        session, boards = as_read(near, written, "", base=base)
        off = pose.rotation_angle(pose.inverse(base @ found.reported) @ session.base_from_flange)
        assert np.rad2deg(np.median(off)) < 6
        named = misread.recognise(session, boards)
        assert named is not None and named.kind == f"Euler angles {written} in degrees"


def test_it_is_named_for_a_board_that_looks_the_same_upside_down(simulated):
    """Every second view is read the other way round."""
    session, boards = as_read(simulated, "ZYZ", "")
    board = Board.of("chessboard", 9, 7, 0.03)
    observations = [
        replace(one, ids=np.arange(len(board.points)), pixels=np.zeros((len(board.points), 2)), points=board.points)
        for one in session.observations
    ]
    session = replace(session, board=board, observations=tuple(observations))
    turned = (np.arange(len(boards)) % 2 == 1)[:, None, None]
    found = misread.recognise(session, np.where(turned, boards @ flips.half_turn(session), boards))
    assert found is not None and found.kind == "Euler angles ZYZ in degrees"


def test_a_rotation_vector_read_as_euler_angles_is_named(simulated):
    found = misread.recognise(*as_read(simulated, "", "ZYX"))
    assert found is not None and found.description == "layout: x y z rx ry rz and angle: deg, without euler"


def test_it_is_named_in_millimetres_too_and_with_the_camera_beside_the_arm(simulated):
    session, boards = as_read(simulated, "xyz", "")
    large = replace(session, readings=tuple(
        replace(one, base_from_flange=pose.rigid(one.base_from_flange[:, :3, :3], 1e3 * one.base_from_flange[:, :3, 3]))
        for one in session.readings
    ))  # fmt: skip
    found = misread.recognise(large, boards)
    assert found is not None and found.kind == "Euler angles xyz in degrees"
    inverse = (simulated[0], boards, pose.inverse(simulated[2]))
    session, boards = as_read(inverse, "xyz", "", eye_to_hand=True)
    found = misread.recognise(replace(session, eye_to_hand=True), boards)
    assert found is not None and found.kind == "Euler angles xyz in degrees"


@pytest.mark.parametrize("options", [{}, {"translation_m": 1e-3, "rotation_deg": 0.3}, {"views": 5}, {"noise_px": 1.0}])
def test_honest_angles_are_not_suspected(simulate, options):
    found = simulate(seed=97, **options)
    honest = (found, estimate.camera_from_boards(found.camera, found.observations), found.reported)
    for written in ("", "xyz", "ZYZ"):
        assert misread.recognise(*as_read(honest, written, written)) is None


def test_the_command_says_what_to_write_instead_of_an_answer(simulated):
    session, _ = as_read(simulated, "xyz", "")
    with pytest.raises(
        CalibrationError, match=r"do not fit together.*Euler angles xyz in degrees.*say euler: xyz and angle: deg"
    ):
        calibrate_handeye(session)
