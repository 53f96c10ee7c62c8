"""A recording that is still being made: each picture is searched for the target once."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from koala3d.calib.errors import TargetError
from koala3d.calib.sessions.session import TargetSession, grey, provenance_of
from koala3d.calib.targets.detection import Observation, detect, read_board
from koala3d.datasets.imaging import images
from koala3d.datasets.imaging.region import Region
from koala3d.datasets.recording import MANIFEST, Recording


@dataclass
class GrowingSession:
    """The views of a recording so far, read anew by each `session`."""

    path: Path
    newest_seen: bool = False  # whether the newest view shows the target
    _found: dict[str, Observation | None] = field(default_factory=dict)
    _size: tuple[int, int] | None = None  # height and width of every image [px]

    def mount(self) -> np.ndarray:
        """(4, 4) flange_from_camera, or base_from_camera, as the rig file states it. Raises TargetError where there is none."""
        manifest = Recording.open(self.path).manifest
        content = manifest.get("nominal_base_from_camera", manifest.get("nominal_flange_from_camera"))
        if content is None:
            raise TargetError("recording does not say how the camera is mounted", where=self.path / MANIFEST)
        return np.asarray(content, np.float64).reshape(4, 4)

    def session(self) -> TargetSession | None:
        """All views that show the target; None where no view does, or nothing has been recorded yet.

        Raises TargetError where an image has another size than the first, and what reading a recording raises.
        """
        if not (self.path / MANIFEST).is_file():
            return None
        recording = Recording.open(self.path)
        board = read_board(recording.manifest.get("board"), where=f"{self.path / MANIFEST}, board")
        for frame in recording.frames:
            if frame.name not in self._found:
                picture = grey(images.read(recording.image_path(frame)))
                self._size = self._size or picture.shape
                if picture.shape != self._size:
                    where, why = recording.image_path(frame), f"{picture.shape}, not {self._size}"
                    raise TargetError("image has another size than the first", where=where, why=why)
                self._found[frame.name] = detect(board, picture, frame.name)
        self.newest_seen = bool(recording.frames) and self._found[recording.frames[-1].name] is not None
        shown = [(frame, seen) for frame in recording.frames if (seen := self._found[frame.name]) is not None]
        if not shown or self._size is None:
            return None
        unseen = tuple(frame.name for frame in recording.frames if self._found[frame.name] is None)
        flown, joints = (np.stack(parts) for parts in zip(*((f.base_from_flange, f.joints) for f, _ in shown), strict=True))
        height, width = self._size
        observations = tuple(seen for _, seen in shown)
        found = TargetSession(board, width, height, observations, flown, unseen, provenance_of(self.path, board), joints=joints)
        region = Region.of_recording(recording.manifest, where=recording.path / MANIFEST)
        beside = recording.manifest.get("eye_to_hand") is True
        return replace(
            found,
            region=region,
            eye_to_hand=beside,
            images={frame.name: recording.image_path(frame) for frame in recording.frames},
        )
