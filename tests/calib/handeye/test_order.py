"""Lists of poses and pictures that are out of step, and whether the message says where that begins."""

import numpy as np
import pytest

from koala3d.calib.calibrate import calibrate_handeye
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import order
from koala3d.calib.intrinsics import estimate
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets import pose

VIEWS = 18
NAMES = [f"{number:03d}" for number in range(VIEWS)]


@pytest.fixture(scope="module")
def honest(simulate):
    simulated = simulate(seed=82, views=VIEWS)
    return simulated, estimate.camera_from_boards(simulated.camera, simulated.observations)


def missing_pose(poses, at):
    """The list lacks a pose: later ones move up, and the last picture gets some other."""
    return np.concatenate([poses[:at], poses[at + 1 :], poses[:1]])


def doubled_pose(poses, at):
    """A pose was stored twice: later ones move down."""
    return np.concatenate([poses[: at + 1], poses[at:-1]])


def swapped(poses, first, second):
    poses = poses.copy()
    poses[[first, second]] = poses[[second, first]]
    return poses


@pytest.mark.parametrize("at", [0, 4, 9, 13])
def test_a_missing_pose_is_named_with_its_view(honest, at):
    simulated, boards = honest
    found = order.recognise(missing_pose(simulated.reported, at), [boards], NAMES)
    assert found.startswith(
        f"from view {NAMES[at]} on, each picture has the pose of the one after it: the pose of view {NAMES[at]}"
    )


@pytest.mark.parametrize("at", [0, 7, 12])
def test_a_pose_less_than_pictures_is_named_with_its_view(honest, at):
    """The poses are taken for those of the first pictures, and the last picture has none."""
    simulated, boards = honest
    fewer = np.concatenate([simulated.reported[:at], simulated.reported[at + 1 :]])
    found = order.recognise(fewer, [boards[:-1]], NAMES[:-1])
    assert found.endswith(f"the pose of view {NAMES[at]} may be missing")


@pytest.mark.parametrize("at", [0, 9])
def test_it_is_named_for_boards_that_look_the_same_upside_down(honest, at):
    simulated, boards = honest
    middle = np.append(simulated.board.size / 2, 0.0)
    upside_down = boards @ pose.from_rotation_vector([0, 0, np.pi], 2 * middle)
    mixed = np.where((np.arange(VIEWS) % 3 == 0)[:, None, None], upside_down, boards)
    other = np.where((np.arange(VIEWS) % 3 == 0)[:, None, None], boards, upside_down)
    assert order.recognise(simulated.reported, [mixed, other], NAMES) == ""
    assert f"the pose of view {NAMES[at]} may be missing" in order.recognise(
        missing_pose(simulated.reported, at), [mixed, other], NAMES
    )


@pytest.mark.parametrize("at", [4, 9, 13])
def test_a_pose_that_is_there_twice_is_named_with_its_view(honest, at):
    simulated, boards = honest
    found = order.recognise(doubled_pose(simulated.reported, at), [boards], NAMES)
    assert "each picture has the pose of the one before it" in found
    assert any(f"from view {NAMES[start]} on" in found for start in (at, at + 1))  # view `at` fits either way


def test_two_views_that_changed_places_are_named(honest):
    simulated, boards = honest
    assert order.recognise(swapped(simulated.reported, 3, 11), [boards], NAMES) == "views 003 and 011 have each other's pose"


def test_reverse_order_is_named(honest):
    simulated, boards = honest
    assert order.recognise(simulated.reported[::-1], [boards], NAMES) == "the poses are in reverse order"


def test_the_order_of_names_by_characters_is_named(honest):
    """The poses were listed as a shell lists img_1 ... img_18; the board is not seen in every picture."""
    simulated, boards = honest
    listed = [f"img_{number}" for number in range(1, VIEWS + 1)]
    given = simulated.reported[[listed.index(name) for name in sorted(listed)]]
    words = "the poses are in the order of the pictures' names by characters"
    assert order.recognise(given, [boards], listed).startswith(words)
    seen = np.delete(np.arange(VIEWS), [3, 10])
    assert order.recognise(given[seen], [boards[seen]], [listed[i] for i in seen], listed).startswith(words)
    assert order.recognise(simulated.reported, [boards], listed) == ""


def test_nothing_is_suspected_of_honest_lists_nor_of_single_bad_views(honest):
    simulated, boards = honest
    assert order.recognise(simulated.reported, [boards], NAMES) == ""
    bad = simulated.reported.copy()
    bad[5] = bad[5] @ np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    assert order.recognise(bad, [boards], NAMES) == ""


def test_random_order_is_not_explained(honest):
    simulated, boards = honest
    mixed = np.random.default_rng(0).permutation(VIEWS)
    assert order.recognise(simulated.reported[mixed], [boards], NAMES) == ""


def test_the_command_says_so_instead_of_counting_outliers(honest):
    simulated, _ = honest
    wrong = missing_pose(simulated.reported, 9)
    session = TargetSession(simulated.board, 960, 600, tuple(simulated.observations), wrong)
    with pytest.raises(CalibrationError, match=r"from view \S+ on, each picture has the pose of the one after it"):
        calibrate_handeye(session)
