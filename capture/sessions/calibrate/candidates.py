"""Views of the board that the arm can take: drawn at random where the trajectory's own views are, and checked by the planner."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.model.viewpoints import Viewpoint
from koala3d.capture.planning import Obstacles
from koala3d.capture.planning.solutions import solve
from koala3d.datasets import pose

Array = NDArray[np.float64]

COUNT = 300  # reachable views to choose from
PREVIEWED = 60  # of them that are drawn for a person before the session
TRIES = 6  # views drawn for each that is wanted, at most
MAX_TILT_RAD = float(np.radians(55))  # between the optical axis and the board's normal: corners are found well up to there
AIM = 0.3  # the point looked at lies within this share of the board's sides from its middle
ROOM_M = 0.03  # the camera may be this far outside the box of the trajectory's own views


@dataclass(frozen=True)
class Reach:
    """Where the camera may be: the box and the distances of the trajectory's views, and what the arm must keep clear of."""

    low: Array  # (3,) corner of the box [m]
    high: Array  # (3,)
    distance: tuple[float, float]  # from the camera to the board's middle [m]
    obstacles: Obstacles


@dataclass(frozen=True)
class BoardView:
    """One reachable view."""

    base_from_flange: Array  # (4, 4) by the nominal kinematics
    joints: Array  # (m, n) configurations that take it [rad]


def reach_of(trajectory: Trajectory, carrier: Carrier, base_from_board: Array) -> Reach:
    """The room that the views of a trajectory take up around a board.

    Args:
        carrier: the arm with its camera.
        base_from_board: (4, 4) as found in the first views.
    """
    places = np.stack([view.camera_pose(carrier)[:3, 3] for view in trajectory.viewpoints()])
    distances = np.linalg.norm(places - _middle(trajectory, base_from_board), axis=1)
    span = float(distances.min()), float(distances.max())
    return Reach(places.min(axis=0) - ROOM_M, places.max(axis=0) + ROOM_M, span, Obstacles.of(trajectory, carrier))


def draw(trajectory: Trajectory, reach: Reach, base_from_board: Array, seed: int, count: int = COUNT) -> list[BoardView]:
    """Up to `count` views of the board that the arm can take; none where it can take none."""
    rng, found = np.random.default_rng([seed, 19]), []
    for _ in range(TRIES * count):
        if len(found) == count:
            break
        base_from_camera = _drawn(rng, trajectory, reach, base_from_board)
        place = base_from_camera[:3, 3]
        if (place < reach.low).any() or (place > reach.high).any():
            continue
        solved = solve(Viewpoint(base_from_camera), reach.obstacles)
        if not solved.reason:
            found.append(BoardView(reach.obstacles.flange_for(base_from_camera), solved.joints))
    return found


def looking(trajectory: Trajectory, carrier: Carrier, present: Array, count: int) -> list[Array]:
    """Joint angles of up to `count` views to look for the board from: of the trajectory's own, evenly spread, that can be taken.

    Each is the configuration nearest to the one before, the first to the `present` (n,) joint angles.
    """
    obstacles, found = Obstacles.of(trajectory, carrier), []
    views = trajectory.viewpoints()
    for index in np.unique(np.linspace(0, len(views) - 1, count).round().astype(int)):
        solved = solve(views[index], obstacles)
        if not solved.reason:
            found.append(nearest(solved.joints, found[-1] if found else present))
    return found


def preview(trajectory: Trajectory, obstacles: Obstacles, seed: int) -> Array:
    """(m, n) configurations [rad] before the board is seen: of the views that look for it, and around where it should be."""
    solved = [solve(view, obstacles) for view in trajectory.viewpoints()]
    views = [one.joints for one in solved if not one.reason]
    if trajectory.board is not None:
        board = trajectory.base_from_board
        views += [one.joints for one in draw(trajectory, reach_of(trajectory, obstacles.carrier, board), board, seed, PREVIEWED)]
    home = obstacles.carrier.arm.home
    return np.array([nearest(joints, home) for joints in views]).reshape(-1, len(home))


def nearest(joints: Array, present: Array) -> Array:
    """(n,) of the (m, n) configurations that needs the shortest motion of the fastest joint."""
    return np.asarray(joints[int(np.abs(joints - present).max(axis=1).argmin())], np.float64)


def _middle(trajectory: Trajectory, base_from_board: Array) -> Array:
    """(3,) middle of the board in the base [m]."""
    return np.asarray(base_from_board @ np.append(_sides(trajectory) / 2, [0.0, 1.0]), np.float64)[:3]


def _sides(trajectory: Trajectory) -> Array:
    """(2,) sides of the board [m]."""
    board = trajectory.target
    assert board is not None  # the command asks for a trajectory with a target
    return board.size


def _drawn(rng: np.random.Generator, trajectory: Trajectory, reach: Reach, base_from_board: Array) -> Array:
    """(4, 4) base_from_camera: tilts even over the sphere, any side and turn, distances even in their logarithm."""
    tilt = np.arccos(rng.uniform(np.cos(MAX_TILT_RAD), 1))
    side, turn = rng.uniform(0, 2 * np.pi, 2)
    aim = (0.5 + AIM * rng.uniform(-1, 1, 2)) * _sides(trajectory)
    distance = np.exp(rng.uniform(*np.log(reach.distance)))
    tilted = pose.from_rotation_vector([tilt * np.cos(side), tilt * np.sin(side), 0.0])
    board_from_camera = tilted @ pose.from_rotation_vector([0.0, 0.0, turn])  # at no tilt along the board's z axis, into it
    board_from_camera[:3, 3] = np.append(aim, 0.0) - distance * board_from_camera[:3, 2]
    return np.asarray(base_from_board @ board_from_camera, np.float64)
