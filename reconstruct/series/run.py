"""A series from its file to its page: which step of which object is next, what has failed, what is there.

OUT/OBJECT/...                 see `plan` and `step`
OUT/index.html, series.csv     the page and the table, written anew when a step begins or ends
OUT/mean                       the mean piece of those that are compared with one surface, at the end
OUT/series.json                the same for programs; it also keeps which recordings `--watch` has found
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from koala3d.datasets.core import files, locks
from koala3d.datasets.core.console import hint
from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.experiments.waiting import Runner
from koala3d.reconstruct.series import mean, page
from koala3d.reconstruct.series.file import Series
from koala3d.reconstruct.series.plan import Piece, Times, plan
from koala3d.reconstruct.series.step import Step
from koala3d.reconstruct.series.table import FORMAT, TABLE, VERSION, Row, row_of
from koala3d.reconstruct.series.watch import Watch

NEEDED = ("build", "mask", "check", "train")
"""Steps without which no later one can run."""
STATES = ("failed", "running", "waiting", "done")
"""In the order of the page."""


@dataclass
class Progress:
    """What has happened to the objects since this process began."""

    given: set[str] = field(default_factory=set)
    """Names of steps that an engine has, those that it runs included."""
    running: set[str] = field(default_factory=set)
    """Names of steps that run."""
    failed: dict[str, str] = field(default_factory=dict)
    """Error by the name of the step."""


class Shelf:
    """The objects of a series, their steps, and how far they are."""

    def __init__(self, series: Series, out: Path, watch: Watch | None = None) -> None:
        """Plan a series into `out`. Raises UsageError: `out` holds something else, or was made with other settings."""
        self.out, self.watch, self.progress = Path(out).absolute(), watch, Progress()
        if watch is not None and series.calibration is None:
            raise UsageError("key 'calibration' is missing", where=series.path, why="--watch finds recordings", remedy="add it")
        before: dict[str, Any] = {}
        if (self.out / TABLE).is_file():
            before = files.read_json(self.out / TABLE, kind=FORMAT, version=VERSION)
        else:
            files.refuse_existing(self.out)
        self.watched = {str(name): Path(path) for name, path in before.get("watched", {}).items()}
        self.series = series.with_recordings(self.watched)
        self.pieces = plan(self.series, self.out)
        self.times = Times(series.about.budget_s)
        for step in (step for piece in self.pieces.values() for step in piece.steps if step.done):
            self.times.add(step.kind, step.read()["seconds"])
        if not self.pieces and watch is None:
            raise UsageError(
                "there are no objects", where=series.path, remedy="list recordings under 'objects', or --watch a folder"
            )

    def batches(self) -> Iterator[Sequence[Step]]:
        """Steps that can start, the next one of each object; ends when there are no more to come."""
        while True:
            if self.watch is not None:
                self._take(self.watch.new(self.series.items))
            ready = [step for piece in self.pieces.values() if (step := self._next(piece)) is not None]
            if not ready and not self.progress.given and (self.watch is None or self.watch.over):
                return
            self.progress.given |= {step.name for step in ready}
            yield ready

    def told(self, step: Step, problem: str | None) -> None:
        """A step has begun (None), or has ended, with its error or ""; the page follows."""
        if problem is None:
            self.progress.running.add(step.name)
            return self.write()
        self.progress.running.discard(step.name)
        self.progress.given.discard(step.name)
        if problem:
            self.progress.failed[step.name] = problem
            hint(f"{step.name}: {problem}")
        else:
            seconds = step.read()["seconds"]
            self.times.add(step.kind, seconds)
            hint(f"{step.name}: {seconds:.0f} s")
        if self.watch is not None:
            self.watch.touch()
        self.write()

    def rows(self) -> list[Row]:
        """A row for each object, failures first, then those at work, those that wait, and those that are done."""
        means: dict[str, tuple[str, float]] = {}
        for kind in mean.kinds(self.pieces):
            means |= {name: (kind.name, away) for name, away in mean.read(kind, self.out).items()}
        rows = [row_of(piece, *self._state(piece), means.get(name)) for name, piece in self.pieces.items()]
        return sorted(rows, key=lambda row: STATES.index(row.state))

    def write(self) -> None:
        """Write page and tables; they replace the former ones."""
        scenes = {name: piece.scene for name, piece in self.pieces.items()}
        page.write(self.rows(), scenes, self.out, {name: str(path) for name, path in self.watched.items()})

    def _take(self, found: dict[str, Path]) -> None:
        """Add recordings that have come."""
        if found:
            self.watched |= found
            self.series = self.series.with_recordings(found)
            self.pieces = plan(self.series, self.out)
            self.write()
            for name in found:
                hint(f"{name}: its recording is complete")

    def _next(self, piece: Piece) -> Step | None:
        """The step of an object that can start; None while one is running, where it has to wait, or where there is none."""
        if any(step.name in self.progress.given for step in piece.steps):
            return None
        for step in piece.steps:
            if step.done:
                continue
            if step.name not in self.progress.failed:
                other = self._waits_for(piece, step)
                if other is None:
                    return self.times.with_left(piece, step)
                if not self._is_lost(other):
                    return None
                self.progress.failed[step.name] = f"needs the training of {other.place.name}, which failed"
            if step.kind in NEEDED:
                return None
        return None

    def _waits_for(self, piece: Piece, step: Step) -> Step | None:
        """The training of another object that must be done before a step can start."""
        first = next(iter(self.pieces.values()))
        if step.kind == "train" and self.series.about.from_first and piece is not first:
            return _training_left(first)
        if step.kind == "compare" and piece.reference is not None:
            return _training_left(self.pieces[piece.reference])
        return None

    def _is_lost(self, step: Step) -> bool:
        """Whether a step will not be done, since it or one before it has failed."""
        before = self.pieces[step.place.name].steps
        return any(one.name in self.progress.failed for one in before[: before.index(step) + 1])

    def _state(self, piece: Piece) -> tuple[str, str, str]:
        """State of an object, the step that it is at, and its error."""
        failed = [step for step in piece.steps if step.name in self.progress.failed]
        at = next((step for step in piece.steps if step.name in self.progress.running), None)
        left = next((step for step in piece.steps if not step.done), None)
        if failed:
            return "failed", failed[0].kind, self.progress.failed[failed[0].name]
        if at is not None:
            return "running", at.kind, ""
        return ("waiting", left.kind, "") if left is not None else ("done", "", "")


def _training_left(piece: Piece) -> Step | None:
    """The training of an object unless it is done."""
    return next((step for step in piece.steps if step.kind == "train" and not step.done), None)


def run(shelf: Shelf, runner: Runner[Step]) -> dict[str, Any]:
    """Run what is left of a series; its page is there from the beginning and written anew when a step begins or ends.

    With a `Watch`, Ctrl-C is an end like any other.

    Raises:
        UsageError: another process runs this series, or a cluster is not as it has to be.
        ReconstructError: objects failed; the others are finished and on the page.
    """
    files.make_folder(shelf.out)
    with locks.beside(shelf.out, "series"):
        try:
            shelf.write()
            for step, problem in runner(shelf.batches()):
                shelf.told(step, problem)
            for kind in mean.kinds(shelf.pieces):
                mean.write(kind, shelf.out)
        except KeyboardInterrupt:
            if shelf.watch is None:
                raise
        finally:
            shelf.progress.running.clear()
            shelf.write()
    rows = shelf.rows()
    if shelf.watch is not None:
        with suppress(OSError):
            for name, missing in shelf.watch.begun(shelf.series.items).items():
                hint(f"{name}: not taken, {missing} views of its recording are missing")
    failed = [row for row in rows if row.state == "failed"]
    if failed:
        what, why = f"{len(failed)} of {len(rows)} objects failed", f"{failed[0].name}, {failed[0].step}: {failed[0].error}"
        remedy = "fix it and run the series again: what is done is kept"
        raise ReconstructError(what, where=shelf.out / page.PAGE, why=why, remedy=remedy)
    return {"out": str(shelf.out), "objects": [row.content() for row in rows], "page": str(shelf.out / page.PAGE)}
