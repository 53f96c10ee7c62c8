"""The steps of each object: the commands of the tutorial, in their order, with what each waits for.

OUT/OBJECT/scene, masked, run, mesh.ply, report, asset.glb, compare    what they write
"""

import os
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.experiments.waiting import Needs
from koala3d.reconstruct.series.file import Item, Series, StepNeeds
from koala3d.reconstruct.series.step import Step

GUESSED_S = {
    "build": 10.0,
    "mask": 30.0,
    "check": 20.0,
    "train": 240.0,
    "eval": 20.0,
    "mesh": 20.0,
    "report": 20.0,
    "asset": 120.0,
    "compare": 60.0,
}
"""Time of each step before one has been measured [s]."""
SCENE, MASKED, MODEL, MESH, REPORT, ASSET, COMPARE = "scene", "masked", "run", "mesh.ply", "report", "asset.glb", "compare"
"""Names in the folder of an object."""


@dataclass(frozen=True)
class Piece:
    """An object and its steps in their order."""

    item: Item
    steps: tuple[Step, ...]
    reference: str | None
    """Name of the object that it is compared with; None for a drawing, or if it is compared with nothing."""

    @property
    def place(self) -> Path:
        """Its folder."""
        return self.steps[0].place

    @property
    def scene(self) -> Path:
        """Its scene."""
        return self.place / SCENE if self.item.scene is None else self.item.scene


def plan(series: Series, out: Path) -> dict[str, Piece]:
    """All objects with their steps, by name; paths in the commands are relative to the folder of the series' file.

    Raises UsageError: a finished step was run as another command.
    """
    first = next(iter(series.items), "")
    pieces = {name: _piece(series, item, out.absolute(), first) for name, item in series.items.items()}
    for piece in pieces.values():
        for step in piece.steps:
            if step.done and (before := step.read()["command"]) != step.command:
                why, remedy = f"it was '{before}', and is '{step.command}' now", f"choose another --out, or remove {piece.place}"
                raise UsageError("was run with other settings", where=step.result, why=why, remedy=remedy)
    return pieces


def _piece(series: Series, item: Item, out: Path, first: str) -> Piece:
    """An object with its steps."""
    about, place = series.about, out / item.name
    scene = place / SCENE if item.scene is None else item.scene
    run, seen = place / MODEL, lambda path: os.path.relpath(path, series.folder)
    stands = ("--stands-on", about.stands_on) if about.stands_on is not None else ()
    words: dict[str, tuple[Path | None, Sequence[str]]] = {}
    if item.recording is not None:
        calibrated = ("--calibration", seen(series.calibration or ""))
        words["build"] = scene, ("datasets", "build", seen(item.recording), *calibrated, "--out", seen(scene))
        if about.mask:
            words["mask"] = place / MASKED, ("datasets", "mask", seen(scene), "--out", seen(place / MASKED))
            scene = place / MASKED
    if about.check != "none":
        words["check"] = None, ("datasets", "check", seen(scene))
    words["train"] = run, ("reconstruct", "train", seen(scene), *_training(series, item, out, first), "--out", seen(run))
    if "eval" in about.outputs:
        words["eval"] = None, ("reconstruct", "eval", seen(run), *stands)
    if "mesh" in about.outputs:
        words["mesh"] = place / MESH, ("reconstruct", "mesh", seen(run), *stands, "--out", seen(place / MESH))
    if "report" in about.outputs:
        calibrated = () if item.recording is None else ("--calibration", seen(series.calibration or ""))
        words["report"] = place / REPORT, ("reconstruct", "report", seen(run), *calibrated, "--out", seen(place / REPORT))
    if "asset" in about.outputs:
        words["asset"] = place / ASSET, ("reconstruct", "asset", seen(run), *stands, "--out", seen(place / ASSET))
    reference = None
    if "compare" in about.outputs and (item.drawing is not None or item.like is not None or item.name != first):
        reference = (item.like or first) if item.drawing is None else None
        other = out / reference / MODEL if item.drawing is None else item.drawing
        tolerance = () if about.tolerance_m is None else ("--tolerance", f"{about.tolerance_m:g}")
        compared = ("reconstruct", "compare-shape", seen(run), seen(other), *stands, *tolerance)
        words["compare"] = place / COMPARE, (*compared, "--out", seen(place / COMPARE))
    steps = [
        Step(
            place,
            kind,
            tuple(command),
            series.folder,
            written,
            kind == "check" and about.check == "go_on",
            _needs(about.needs, kind),
        )
        for kind, (written, command) in words.items()
    ]
    return Piece(item, tuple(steps), reference)


def _training(series: Series, item: Item, out: Path, first: str) -> list[str]:
    """Options of a training; of one that begins with the weights of the first, model and preset are the first's."""
    about = series.about
    later = about.from_first and item.name != first
    start = (
        ["--from", os.path.relpath(out / first / MODEL, series.folder)]
        if later
        else ["--model", about.model, "--preset", about.preset]
    )
    budget = [] if about.budget_s is None else ["--budget", f"{about.budget_s:g}"]
    return [*start, *(word for setting in about.overrides for word in ("--set", setting)), *budget]


def _needs(stated: Mapping[str, StepNeeds], kind: str) -> Needs:
    """What a step occupies. Only a training gets a GPU where nobody has said."""
    given = stated.get(kind, StepNeeds())
    gpus = given.gpus if given.gpus is not None or kind == "train" else 0.0
    return Needs(given.cores, given.memory_gb, gpus)


class Times:
    """How long steps take: as long as their like took, or a guess."""

    def __init__(self, budget_s: float | None) -> None:
        self._guessed = {**GUESSED_S, **({"train": budget_s + 30} if budget_s is not None else {})}
        self._measured: dict[str, list[float]] = {}

    def add(self, kind: str, seconds: float) -> None:
        """A step of a kind has taken so long [s]."""
        self._measured.setdefault(kind, []).append(seconds)

    def of(self, kind: str) -> float:
        """What a step of a kind will take [s]."""
        return statistics.median(self._measured[kind]) if kind in self._measured else self._guessed[kind]

    def with_left(self, piece: Piece, step: Step) -> Step:
        """The step, with the time that it and the ones after it will take."""
        left = piece.steps[piece.steps.index(step) :]
        return replace(step, left_s=sum(self.of(one.kind) for one in left))
