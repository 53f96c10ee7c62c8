"""How a command that records a session opens its rig: examined first, and closed at the end."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from koala3d.datasets.core import console
from koala3d.datasets.recording import UPRIGHT

if TYPE_CHECKING:
    from koala3d.capture.model.trajectory import Trajectory
    from koala3d.capture.rig.moves import Moves, NextMove
    from koala3d.capture.rig.rig import Rig


CAMERA = ("driver", "model", "serial")
"""What the log says of a camera; the manifest has the rest."""


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
    pose: str = UPRIGHT
    slow: float = 1.0
    ask: "Callable[[NextMove], bool] | None" = None

    def moves(self) -> "Moves":
        """What moves the arm; says on the terminal what its first move will be."""
        from koala3d.capture.rig.moves import Moves

        return Moves(self.slow, self.ask, lambda words: console.hint(f"resuming; {words}" if self.resume else words))

    @contextmanager
    def opened(self, trajectory: "Trajectory", out: Path) -> "Iterator[Rig]":
        """The rig of a session that writes to `out` and keeps its log. Entering raises CaptureError where it is not ready."""
        from koala3d.capture.doctor.examine import examination
        from koala3d.capture.drivers.events import event
        from koala3d.capture.recording import provenance, session_log
        from koala3d.capture.rig.opening import open_rig

        encoded = trajectory.camera.pixel_format == "rgb8"
        opening = open_rig(
            self.rig,
            trajectory,
            scene=self.scene,
            seed=self.seed,
            time_scale=self.time_scale,
            examine=examination(out, trajectory.upwards, encoded, self.take_over, ignore=self.ignore),
            take_over=self.take_over,
            radiometry=self.radiometry,
            moves=self.moves(),
            pose=self.pose,
        )
        with session_log.kept(out, **provenance.facts(), resume=self.resume), opening as rig:
            cameras = [{key: one.camera.description().get(key) for key in CAMERA} for one in rig.each.values()]
            event("rig", name=rig.name, robot=rig.robot.description(), cameras=cameras)
            yield rig
