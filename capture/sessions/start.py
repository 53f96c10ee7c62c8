"""How a command that records a session opens its rig: examined first, and closed at the end."""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from koala3d.capture.model.trajectory import Trajectory
    from koala3d.capture.rig.rig import Rig


@dataclass(frozen=True)
class SessionOptions:
    """What a person says of the rig and of the session."""

    rig: str
    scene: str = ""
    seed: int = 0
    time_scale: float = 20.0
    radiometry: Path | None = None
    take_over: bool = False
    resume: bool = False
    ignore: tuple[str, ...] = ()

    def opened(self, trajectory: "Trajectory", out: Path) -> "AbstractContextManager[Rig]":
        """The rig of a session that writes to `out`. Entering raises CaptureError where it is not ready."""
        from koala3d.capture.doctor.examine import examination
        from koala3d.capture.rig.opening import open_rig

        encoded = trajectory.camera.pixel_format == "rgb8"
        return open_rig(
            self.rig,
            trajectory,
            scene=self.scene,
            seed=self.seed,
            time_scale=self.time_scale,
            examine=examination(out, trajectory.upwards, encoded, self.take_over, ignore=self.ignore),
            take_over=self.take_over,
            radiometry=self.radiometry,
        )
