"""Several cameras on one mount that saw the same target: the equations of `calib.handeye.model` side by side.

All cameras share the target's pose and shape and the joints' offsets. Views that were taken at the same stop share the arm's
error too, which then drops out of the pose between the cameras. The global unknowns are, in this order: for each camera its free
intrinsics and mount_from_camera (6); the joints' offsets; the target's shape; stand_from_board (6).
"""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from calib.arrays import Array, Indices, Mask
from calib.handeye import surface
from calib.handeye.model import Accuracy, Session, State, perturbed, predict
from datasets.kinematics import Links


@dataclass(frozen=True)
class CamerasState:
    """The unknowns."""

    intrinsics: tuple[Array, ...]  # (12,) of each camera
    mount_from_camera: tuple[Array, ...]  # (4, 4) of each camera
    stand_from_board: Array  # (4, 4)
    corrections: Array  # (stops, 6)
    offsets: Array = field(default_factory=lambda: np.zeros(6))  # (joints,)
    shape: Array = field(default_factory=surface.FLAT.copy)  # (4,) of the target

    def of(self, camera: int, stops: Indices) -> State:
        """What one camera sees of them; `stops` (views,) are the stops of its views."""
        return State(
            self.intrinsics[camera],
            self.mount_from_camera[camera],
            self.stand_from_board,
            self.corrections[stops],
            self.offsets,
            self.shape,
        )


@dataclass(frozen=True)
class Cameras:
    """What was measured, as a problem for `calib.handeye.refine`. "View" means stop there."""

    sessions: tuple[Session, ...]
    stops: tuple[Indices, ...]  # of each session: (views,) at which stop the view was taken
    noise: tuple[float, ...]  # standard deviation of each camera's corners over that of the first: `pixels` are divided by it

    @property
    def view(self) -> Indices:
        """(n,) stop of each corner, camera after camera."""
        return np.concatenate([stops[session.view] for session, stops in zip(self.sessions, self.stops, strict=True)])

    @property
    def pixels(self) -> Array:
        """(n, 2) corners, in pixels of the first camera."""
        return np.concatenate([session.pixels / noise for session, noise in zip(self.sessions, self.noise, strict=True)])

    @property
    def accuracy(self) -> Accuracy:
        """Of the arm, as stated."""
        return self.sessions[0].accuracy

    @property
    def turning(self) -> list[int]:
        """Joints whose offsets are estimated."""
        return self.sessions[0].turning

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

    def columns_of(self, camera: int) -> list[int]:
        """Where among the global unknowns those of a camera's own session are, in that session's order."""
        widths = [len(session.free) + 6 for session in self.sessions]
        first, shared, free = sum(widths[:camera]), sum(widths), len(self.sessions[camera].free)
        mount, common = range(first + free, first + free + 6), range(shared, shared + self._common)
        return [*range(first, first + free), *common, *mount, *range(common.stop, common.stop + 6)]

    @property
    def _common(self) -> int:
        """Number of unknowns of joints and target, which are the same for all cameras."""
        return len(self.turning) + len(self.sessions[0].shaped)

    @property
    def unknowns(self) -> int:
        """Number of global unknowns."""
        return self.columns_of(0)[-1] + 1

    def corners_of(self, camera: int) -> slice:
        """Which of the corners are a camera's."""
        counts = [len(session.view) for session in self.sessions]
        return slice(sum(counts[:camera]), sum(counts[: camera + 1]))

    def some(self, chosen: Mask) -> Self:
        """The same with the corners of `chosen` (n,) alone; stops keep their numbers."""
        parts = (session.some(chosen[self.corners_of(camera)]) for camera, session in enumerate(self.sessions))
        return replace(self, sessions=tuple(parts))

    def predicted(self, state: CamerasState) -> tuple[Array, Array, Array]:
        """Corners in pixels of the first camera, and their derivatives by the global unknowns and by their stop's correction."""
        pixels, by_global, by_stop = [], [], []
        for camera, (session, stops, noise) in enumerate(zip(self.sessions, self.stops, self.noise, strict=True)):
            seen, own, correction = predict(session, state.of(camera, stops))
            wide = np.zeros((len(seen), 2, self.unknowns))
            wide[..., self.columns_of(camera)] = own
            pixels.append(seen / noise)
            by_global.append(wide / noise)
            by_stop.append(correction / noise)
        return np.concatenate(pixels), np.concatenate(by_global), np.concatenate(by_stop)

    def moved(self, state: CamerasState, step: Array, view_steps: Array) -> CamerasState:
        """`state` after a step of the global unknowns and of the stops' corrections."""
        none = [0 * state.corrections[stops] for stops in self.stops]
        each = [
            session.moved(state.of(camera, stops), step[self.columns_of(camera)], none[camera])
            for camera, (session, stops) in enumerate(zip(self.sessions, self.stops, strict=True))
        ]
        return CamerasState(
            tuple(one.intrinsics for one in each),
            tuple(one.mount_from_camera for one in each),
            perturbed(state.stand_from_board, step[-6:]),
            state.corrections + view_steps,
            each[0].offsets,
            each[0].shape,
        )

    def known_rows(self, state: CamerasState) -> Array:
        """What is known of the cameras, and once what is known of joints and target."""
        placed = []
        for camera, (session, stops) in enumerate(zip(self.sessions, self.stops, strict=True)):
            rows = session.known_rows(state.of(camera, stops))
            wide = np.zeros((len(rows), self.unknowns + 1))
            wide[:, [*self.columns_of(camera), -1]] = rows
            placed.append(wide if camera == 0 else wide[: len(wide) - self._common])
        return np.concatenate(placed)

    def _at_stops(self, values: list[Array]) -> Array:
        """(stops, ...) values of views at their stops."""
        found = np.zeros((1 + max(int(stops.max()) for stops in self.stops), *values[0].shape[1:]))
        for stops, value in zip(self.stops, values, strict=True):
            found[stops] = value
        return found
