"""Recordings that appear in a folder while the arm goes on."""

import time
from collections.abc import Mapping
from pathlib import Path

from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.incidents import left_out
from koala3d.datasets.recording import MANIFEST, Recording
from koala3d.reconstruct.series.file import NAME, Item


class Watch:
    """A folder in which recordings appear."""

    def __init__(self, folder: Path, idle_s: float | None) -> None:
        """Look at `folder`, until nothing new has happened for `idle_s` seconds; None: until Ctrl-C."""
        self.folder, self._idle_s = Path(folder).absolute(), idle_s
        self._changed = time.monotonic()

    def new(self, items: Mapping[str, Item]) -> dict[str, Path]:
        """Complete recordings that are not among the objects yet, by name."""
        found = {place.name: place for place in self._others(items) if missing_views(place) == 0}
        if found:
            self.touch()
        return found

    def begun(self, items: Mapping[str, Item]) -> dict[str, int]:
        """How many views are missing of recordings that are not complete, by name."""
        return {place.name: missing for place in self._others(items) if (missing := missing_views(place))}

    def _others(self, items: Mapping[str, Item]) -> list[Path]:
        """What could be further recordings, in the order of names."""
        known = {item.recording.resolve() for item in items.values() if item.recording is not None}
        names = (place for place in sorted(self.folder.iterdir()) if NAME.fullmatch(place.name) and place.name not in items)
        return [place for place in names if place.resolve() not in known]

    def touch(self) -> None:
        """Something has happened: a recording came, or a step ended."""
        self._changed = time.monotonic()

    @property
    def over(self) -> bool:
        """Whether nothing has happened for the agreed time."""
        return self._idle_s is not None and time.monotonic() - self._changed > self._idle_s


def missing_views(place: Path) -> int | None:
    """How many of its planned views a recording has still to take, but those that its session gave up; None: no recording.

    Of one without a plan, 1 while a session holds its lock, or if it has no picture.
    """
    if not (place / MANIFEST).is_file():
        return None
    try:
        recording = Recording.open(place)
    except KoalaError:  # it is being copied
        return None
    planned, taken = recording.planned_views, len(recording.frames)
    if planned is None:
        return int(taken == 0 or place.with_name(f".{place.name}.lock").exists())
    return max(planned - taken - len(left_out(recording)), 0)
