"""Poses as people get them wrong, and whether the message names how."""

import numpy as np
import pytest

from koala3d.calib.calibrate import calibrate_handeye
from koala3d.calib.errors import CalibrationError, Unobservable
from koala3d.calib.handeye import mistakes
from koala3d.calib.intrinsics import estimate
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets import pose

MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


def millimetres(poses):
    return pose.rigid(poses[:, :3, :3], 1e3 * poses[:, :3, 3])


def swapped_quaternions(poses):
    """Written as x y z w, read as w x y z."""
    read = np.roll(pose.quaternion(poses), -1, axis=-1)
    return np.stack([pose.from_quaternion(q, p[:3, 3]) for q, p in zip(read, poses, strict=True)])


def transposed(poses):
    return pose.rigid(np.swapaxes(poses[:, :3, :3], 1, 2), poses[:, :3, 3])


CASES = [
    (millimetres, "positions are in millimetres"),
    (lambda p: pose.rigid(p[:, :3, :3], p[:, :3, 3] / 1e3), "factor of 1000"),
    (pose.inverse, "poses are inverse"),
    (transposed, "rotations are transposed"),
    (swapped_quaternions, "quaternions are x y z w, but were read as w x y z"),
    (lambda p: MIRROR @ p @ MIRROR, "left-handed"),
    (lambda p: pose.from_rotation_vector(np.deg2rad(pose.rotation_vector(p)), p[:, :3, 3]), "radians, but were read as degrees"),
    (lambda p: millimetres(pose.inverse(p)), "inverse.*millimetres"),
]
NAMES = ["millimetres", "target in millimetres", "inverse", "transposed", "quaternion", "mirror", "radians", "inverse mm"]


@pytest.fixture(scope="module")
def honest(simulate):
    simulated = simulate(seed=81, views=15)
    return simulated, estimate.camera_from_boards(simulated.camera, simulated.observations)


@pytest.mark.parametrize(("mistake", "words"), CASES, ids=NAMES)
def test_the_mistake_is_named(honest, mistake, words):
    simulated, boards = honest
    with pytest.raises(CalibrationError, match=f"do not fit together.*{words}"):
        mistakes.explain(mistake(simulated.reported), boards)


@pytest.mark.parametrize(("mistake", "words"), [CASES[0], CASES[2], CASES[6]], ids=["millimetres", "inverse", "radians"])
def test_the_command_says_so_instead_of_giving_an_answer(honest, mistake, words):
    simulated, _ = honest
    session = TargetSession(simulated.board, 960, 600, tuple(simulated.observations), mistake(simulated.reported))
    with pytest.raises(CalibrationError, match=words):
        calibrate_handeye(session)


def test_honest_poses_are_not_suspected(simulate):
    for seed, options in enumerate(({}, {"translation_m": 1e-3, "rotation_deg": 0.1}, {"views": 6}, {"noise_px": 1.0})):
        simulated = simulate(seed=90 + seed, **options)
        boards = estimate.camera_from_boards(simulated.camera, simulated.observations)
        assert mistakes.recognise(simulated.reported, boards) == ""


def test_nonsense_has_no_name(honest):
    simulated, boards = honest
    assert mistakes.recognise(np.roll(simulated.reported, 4, axis=0), boards) == ""


def test_weak_motion_is_not_mistaken_for_a_mistake(simulate, make_viewpoints):
    still = simulate(seed=95, poses=lambda rng: make_viewpoints(rng, 12, axis=0.3, turn=False))
    session = TargetSession(still.board, 960, 600, tuple(still.observations), still.reported)
    with pytest.raises(Unobservable):
        calibrate_handeye(session)
