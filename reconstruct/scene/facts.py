"""What is measured on a scene before it is trained: kept in run.json beside the configuration, never written into it.

Where the configuration has a value of its own for one of these, that value counts.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.scene import Scene, View
from koala3d.reconstruct.scene.frustum import Frustum
from koala3d.reconstruct.scene.light import STILL, LightFrame
from koala3d.reconstruct.scene.rays import Normalisation, direction_of_cameras
from koala3d.reconstruct.scene.twists import Session

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class SceneFacts:
    """Of one scene and its training views."""

    normalisation: Normalisation
    """Where the object is, how large, whether there is anything around it, and how near and far it is seen."""
    towards: Vector | None = None
    """Mean direction from the object to the cameras; None: not measured."""
    half_box: Vector | None = None
    """Half the size of the object's box [scene unit] where there is something around it."""
    box_is_stated: bool = False
    """Whether the scene states the object's box; else the pictures suggest it."""
    log_gains: tuple[Vector, ...] | None = None
    """Logarithm of each view's gain per colour, from matched points; None: not measured."""
    light: LightFrame = STILL
    """Where the lamps stand still, as it was decided."""
    session: tuple[tuple[float, ...], ...] | None = None
    """`Session.spread`, a row for each training view, where the pose of an object that was turned over is free; see `poses`."""

    @classmethod
    def of(cls, scene: Scene, views: tuple[View, ...], normalisation: Normalisation) -> "SceneFacts":
        """Measure a scene. `views`: those that are trained on."""
        half_box = None
        if not normalisation.bounded:
            x, y, z = (np.diff(scene.box, axis=0)[0] / 2 * normalisation.scale).tolist()
            half_box = (x, y, z)
        return cls(normalisation, direction_of_cameras(views, normalisation), half_box, scene.box_is_stated)

    def with_gains(self, log: NDArray[np.float64]) -> "SceneFacts":
        """The same with the (views, 3) log gains of its views."""
        return replace(self, log_gains=tuple(tuple(gain) for gain in log.tolist()))

    @property
    def free_session(self) -> Session | None:
        """The second session before it has moved; None where none is free."""
        if self.session is None:
            return None
        return Session(jnp.asarray(self.session, jnp.float32).reshape(-1, 6, 6), jnp.zeros(6))

    def to_json(self) -> dict[str, Any]:
        """As run.json has it."""
        return asdict(self)

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> "SceneFacts":
        """Inverse of `to_json`. Raises KeyError, TypeError or ValueError where something is missing or unknown."""
        normalisation = {**content["normalisation"], "centre": tuple(content["normalisation"]["centre"])}
        if frustum := normalisation.get("frustum"):
            normalisation["frustum"] = Frustum.from_json(frustum)
        vectors = {name: None if (v := content.get(name)) is None else tuple(v) for name in ("towards", "half_box")}
        gains = None if (v := content.get("log_gains")) is None else tuple(tuple(gain) for gain in v)
        session = None if (v := content.get("session")) is None else tuple(tuple(row) for row in v)
        parts = {"normalisation": Normalisation(**normalisation), "log_gains": gains, "session": session}
        return cls(**{**content, **vectors, **parts, "light": LightFrame.from_json(content.get("light"))})
