"""Several cameras or several targets on one arm: the equations of `calib.handeye.model` side by side.

A session is what one camera saw of one target. Sessions of one camera share its lens and its mount, sessions of one target share
its pose and its shape, and all share the errors of the arm's links. Views that were taken at the same stop share the arm's error
too: it drops out of the pose between two cameras, and of that between two targets. The global unknowns are, in this order: for
each camera its free intrinsics and mount_from_camera (6); the errors of the links; for each target its shape and
stand_from_board (6).
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from koala3d.calib.arrays import Array, Indices, Mask
from koala3d.calib.handeye.model import Accuracy, Measurements, State, predict
from koala3d.datasets.kinematics import Links


@dataclass(frozen=True)
class JointState:
    """The unknowns."""

    intrinsics: tuple[Array, ...]  # of each camera, in the order of `calib.intrinsics.projection`
    mount_from_camera: tuple[Array, ...]  # (4, 4) of each camera
    stand_from_board: tuple[Array, ...]  # (4, 4) of each target
    shapes: tuple[Array, ...]  # (4,) of each target
    corrections: Array  # (stops, 6)
    link_errors: Array = field(default_factory=lambda: np.zeros(24))  # (4 n,), see `calib.handeye.model.State`


@dataclass(frozen=True)
class JointMeasurements:
    """What was measured, as a problem for `calib.handeye.refine`. "View" means stop there.

    Sessions of one camera have the same free intrinsics, lens and what is known of it.
    """

    sessions: tuple[Measurements, ...]
    cameras: tuple[int, ...]  # number of the camera of each session
    boards: tuple[int, ...]  # number of the target of each session
    stops: tuple[Indices, ...]  # of each session: (views,) at which stop the view was taken
    noise: tuple[float, ...]  # standard deviation of each camera's corners over that of the first: `pixels` are divided by it

    @property
    def view(self) -> Indices:
        """(n,) stop of each corner, session after session."""
        return np.concatenate([stops[session.view] for session, stops in zip(self.sessions, self.stops, strict=True)])

    @property
    def pixels(self) -> Array:
        """(n, 2) corners, in pixels of the first camera."""
        return np.concatenate(
            [session.pixels / self.noise[camera] for session, camera in zip(self.sessions, self.cameras, strict=True)]
        )

    @property
    def accuracy(self) -> Accuracy:
        """Of arm and targets, as stated."""
        return self.sessions[0].accuracy

    @property
    def link_std(self) -> Array:
        """(4 n,) stated deviations of the links' errors that are estimated."""
        return self.sessions[0].link_std

    @property
    def links(self) -> Links:
        """The arm's nominal chain."""
        return self.sessions[0].links

    @property
    def base_from_flange(self) -> Array:
        """(stops, 4, 4) as reported."""
        return self._at_stops([session.base_from_flange for session in self.sessions])

    @property
    def joints(self) -> Array | None:
        """(stops, joints) as reported [rad]; None where a session lacks them."""
        found = [session.joints for session in self.sessions if session.joints is not None]
        return self._at_stops(found) if len(found) == len(self.sessions) else None

    @cached_property
    def _first_columns(self) -> tuple[list[int], list[int]]:
        """Where the unknowns of each camera begin, and where those of each target do."""
        of_cameras = [len(self._of_camera(number).free) + 6 for number in range(1 + max(self.cameras))]
        before = sum(of_cameras) + len(self.sessions[0].erring)
        of_board = len(self.sessions[0].shaped) + 6
        boards = range(before, before + of_board * (1 + max(self.boards)), of_board)
        return np.cumsum([0, *of_cameras]).tolist(), list(boards)

    @property
    def unknowns(self) -> int:
        """Number of global unknowns."""
        return self._first_columns[1][-1] + len(self.sessions[0].shaped) + 6

    def columns_of(self, number: int) -> list[int]:
        """Where among the global unknowns those of a session are, in that session's order."""
        session, (cameras, boards) = self.sessions[number], self._first_columns
        mount = cameras[self.cameras[number]] + len(session.free)
        shape, links = boards[self.boards[number]], range(cameras[-1], cameras[-1] + len(session.erring))
        board = shape + len(session.shaped)
        lens = range(mount - len(session.free), mount)
        return [*lens, *links, *range(shape, board), *range(mount, mount + 6), *range(board, board + 6)]

    def corners_of(self, number: int) -> slice:
        """Which of the corners are a session's."""
        counts = [len(session.view) for session in self.sessions]
        return slice(sum(counts[:number]), sum(counts[: number + 1]))

    def state_of(self, state: JointState, number: int) -> State:
        """What one session sees of the unknowns."""
        camera, board = self.cameras[number], self.boards[number]
        return State(
            state.intrinsics[camera],
            state.mount_from_camera[camera],
            state.stand_from_board[board],
            state.corrections[self.stops[number]],
            state.link_errors,
            state.shapes[board],
        )

    def some(self, chosen: Mask) -> Self:
        """The same with the corners of `chosen` (n,) alone; stops keep their numbers."""
        parts = (session.some(chosen[self.corners_of(number)]) for number, session in enumerate(self.sessions))
        return replace(self, sessions=tuple(parts))

    def predicted(self, state: JointState) -> tuple[Array, Array, Array]:
        """Corners in pixels of the first camera, and their derivatives by the global unknowns and by their stop's correction."""
        pixels, by_global, by_stop = [], [], []
        for number, session in enumerate(self.sessions):
            seen, own, correction = predict(session, self.state_of(state, number))
            wide, noise = np.zeros((len(seen), 2, self.unknowns)), self.noise[self.cameras[number]]
            wide[..., self.columns_of(number)] = own
            pixels.append(seen / noise)
            by_global.append(wide / noise)
            by_stop.append(correction / noise)
        return np.concatenate(pixels), np.concatenate(by_global), np.concatenate(by_stop)

    def moved(self, state: JointState, step: Array, view_steps: Array) -> JointState:
        """`state` after a step of the global unknowns and of the stops' corrections."""
        each = []
        for number, session in enumerate(self.sessions):
            still = np.zeros((len(self.stops[number]), 6))
            each.append(session.moved(self.state_of(state, number), step[self.columns_of(number)], still))
        cameras = [each[self.cameras.index(number)] for number in range(len(state.intrinsics))]
        boards = [each[self.boards.index(number)] for number in range(len(state.shapes))]
        return JointState(
            tuple(one.intrinsics for one in cameras),
            tuple(one.mount_from_camera for one in cameras),
            tuple(one.stand_from_board for one in boards),
            tuple(one.shape for one in boards),
            state.corrections + view_steps,
            each[0].link_errors,
        )

    def known_rows(self, state: JointState) -> Array:
        """What is known of each camera, of the links, and of each target: once, though several sessions know it."""
        placed = []
        for number, session in enumerate(self.sessions):
            rows = session.known_rows(self.state_of(state, number))
            wide = np.zeros((len(rows), self.unknowns + 1))
            wide[:, [*self.columns_of(number), -1]] = rows
            of_target, of_links = len(session.shaped), len(session.erring)
            news = [self.cameras.index(self.cameras[number]), 0, self.boards.index(self.boards[number])]
            kinds = np.repeat([0, 1, 2], [len(rows) - of_links - of_target, of_links, of_target])
            placed.append(wide[np.array(news)[kinds] == number])
        return np.concatenate(placed)

    def _of_camera(self, number: int) -> Measurements:
        """The first session of a camera."""
        return self.sessions[self.cameras.index(number)]

    def _at_stops(self, values: list[Array]) -> Array:
        """(stops, ...) values of views at their stops."""
        found = np.zeros((1 + max(int(stops.max()) for stops in self.stops), *values[0].shape[1:]))
        for stops, value in zip(self.stops, values, strict=True):
            found[stops] = value
        return found
