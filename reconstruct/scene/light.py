"""The frame in which lamps stand still, told from a camera's orientation or from where the object was.

world       the scene's own: lamps stand still about the object
turntable   a room in which the object turns: its axis is z, and cameras are always at the azimuth zero
room        a room in which the object was put in several ways: each view says how it was turned
camera      the camera's: lamps ride on it, near the lens
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from koala3d.datasets import pose
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.turntable import before_turntable
from koala3d.reconstruct.scene.turntable import turning

Frame = Literal["world", "turntable", "room", "camera"]
Vector = tuple[float, float, float]
ALIKE = np.deg2rad(5.0)
"""Azimuths of the cameras in the room may differ by so much: the frame "turntable" takes them to be one."""
STANDS = np.deg2rad(0.1)
"""An object that was turned by less has not moved before the lamps."""


@dataclass(frozen=True)
class LightFrame:
    """Where the lamps of a scene stand still."""

    kind: Frame = "world"
    axis: Vector = (0.0, 0.0, 1.0)
    """Unit vector in the scene about which the object turns; of turntables alone."""
    distance: float = 1.0
    """Median distance of the cameras from the scene's middle [scene unit]."""
    seen: tuple[tuple[float, ...], ...] = ()
    """Of rooms alone, for each training view: the direction in which it looks, and the rotation from the scene's axes to the
    room's, row by row. Other cameras have the light of the view that looks most nearly as they do."""

    @classmethod
    def from_json(cls, content: dict[str, Any] | None) -> "LightFrame":
        """As run.json has it; older runs have nothing, and lamps that stand still."""
        if not content:
            return cls()
        seen = tuple(tuple(row) for row in content.get("seen", ()))
        return cls(**{**content, "axis": tuple(content["axis"]), "seen": seen})

    @property
    def moves(self) -> bool:
        """Whether lamps move about the object."""
        return self.kind != "world"

    @property
    def near(self) -> bool:
        """Whether lamps are so near that the light depends on the place."""
        return self.kind == "camera"

    def from_scene(self, scene_from_camera: ArrayLike) -> Float[np.ndarray, "*views 3 3"] | None:
        """Rotations from the scene's axes to the lamps', by the camera's (..., 3, 3) rotations; None where lamps stand still."""
        rotation = np.asarray(scene_from_camera, np.float64)
        if self.kind == "world":
            return None
        if self.kind == "camera":
            return np.swapaxes(rotation, -1, -2)
        if self.kind == "turntable":
            return before_turntable(self.axis, rotation)
        towards, turned = self.of_room
        return turned[np.argmax(rotation[..., 2] @ towards.T, -1)]

    @property
    def of_room(self) -> tuple[Float[np.ndarray, "views 3"], Float[np.ndarray, "views 3 3"]]:
        """`seen`, as directions and rotations."""
        values = np.asarray(self.seen, np.float64)
        return values[:, :3], values[:, 3:].reshape(-1, 3, 3)

    def of_views(self, views: tuple[View, ...]) -> Float[np.ndarray, "views 3 3"] | None:
        """`from_scene` of the views' poses, float32; in a room of those views that do not say where the object was."""
        found = self.from_scene(np.stack([view.world_from_camera[:3, :3] for view in views]))
        if self.kind == "room" and found is not None:
            placed = [view.base_from_world for view in views]
            found = np.stack([given if one is None else one[:3, :3] for one, given in zip(placed, found, strict=True)])
        return None if found is None else found.astype(np.float32)


STILL = LightFrame()
"""Lamps that stand still about the object."""


def room_of(views: tuple[View, ...]) -> tuple[tuple[float, ...], ...]:
    """`LightFrame.seen` of training views that all say where the object was."""
    turns = [view.base_from_world[:3, :3] for view in views if view.base_from_world is not None]
    return tuple(
        (*view.world_from_camera[:3, 2].tolist(), *turn.ravel().tolist()) for view, turn in zip(views, turns, strict=True)
    )


def stated(scene: Scene) -> tuple[Frame | None, Vector | None]:
    """The frame that a scene states for its training views, and the axis of a turntable; None: it does not say.

    A turntable before a camera on one side of the room is a room of its own kind: any camera's light follows from where it is.
    """
    if scene.lamps != "room":
        return {None: None, "camera": "camera", "object": "world"}[scene.lamps], None
    views = scene.split("train")
    given = [view.base_from_world for view in views if view.base_from_world is not None]
    if len(given) < len(views):
        return (None if given else "turntable"), None
    turns = np.stack([placed[:3, :3] for placed in given])
    if _spread(turns) < STANDS:
        return "world", None
    found = turning(np.swapaxes(turns, -1, -2))
    if found is None or found.agreeing < 1:
        return "room", None
    axis = found.axis * (1.0 if (turns[0] @ found.axis)[2] >= 0 else -1.0)  # upwards in the room
    cameras = np.stack([view.world_from_camera[:3, :3] for view in views])
    if _spread(before_turntable(axis, cameras) @ np.swapaxes(turns, -1, -2)) > ALIKE:
        return "room", None
    x, y, z = axis.tolist()
    return "turntable", (x, y, z)


def _spread(rotations: Float[np.ndarray, "n 3 3"]) -> float:
    """Largest angle from the first of them [rad]."""
    return float(pose.rotation_angle(rotations[0].T @ rotations).max())
