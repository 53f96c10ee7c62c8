"""The frame in which lamps stand still, told from a camera's orientation.

world       the scene's own: lamps stand still about the object
turntable   a room in which the object turns: its axis is z, and cameras are always at the azimuth zero
camera      the camera's: lamps ride on it, near the lens
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from koala3d.datasets.scene import View

Frame = Literal["world", "turntable", "camera"]


@dataclass(frozen=True)
class LightFrame:
    """Where the lamps of a scene stand still."""

    kind: Frame = "world"
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Unit vector in the scene about which the object turns; of turntables alone."""
    distance: float = 1.0
    """Median distance of the cameras from the scene's middle [scene unit]."""

    @classmethod
    def from_json(cls, content: dict[str, Any] | None) -> "LightFrame":
        """As run.json has it; older runs have nothing, and lamps that stand still."""
        return cls(**{**content, "axis": tuple(content["axis"])}) if content else cls()

    @property
    def moves(self) -> bool:
        """Whether lamps move about the object."""
        return self.kind != "world"

    @property
    def near(self) -> bool:
        """Whether lamps are so near that the light depends on the place."""
        return self.kind == "camera"

    def from_scene(self, scene_from_camera: ArrayLike) -> Float[np.ndarray, "*views 3 3"] | None:
        """Rotations from the scene's axes to the lamps', by the camera's (..., 3, 3) rotations; None where lamps stand still.

        The azimuth of a camera that looks along a turntable's axis is that to which the bottom of its picture points.
        """
        rotation = np.asarray(scene_from_camera, np.float64)
        if self.kind == "world":
            return None
        if self.kind == "camera":
            return np.swapaxes(rotation, -1, -2)
        axis = np.broadcast_to(np.asarray(self.axis), rotation.shape[:-1])
        back = -rotation[..., 2] + 1e-5 * rotation[..., 1]  # y is down
        back = back - np.sum(back * axis, -1, keepdims=True) * axis
        back = back / np.maximum(np.linalg.norm(back, axis=-1, keepdims=True), 1e-30)
        return np.stack([back, np.cross(axis, back), axis], -2)

    def of_views(self, views: tuple[View, ...]) -> Float[np.ndarray, "views 3 3"] | None:
        """`from_scene` of the views' poses, float32."""
        found = self.from_scene(np.stack([view.world_from_camera[:3, :3] for view in views]))
        return None if found is None else found.astype(np.float32)


STILL = LightFrame()
"""Lamps that stand still about the object."""
