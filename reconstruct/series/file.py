"""The file of a series: its objects, what they share, and rules.

    objects: [recordings/cup_1, recordings/cup_2]
    calibration: calibration.json

is enough. Paths are relative to the file.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, field_validator, model_validator

from koala3d.datasets.core.errors import UsageError, nearest
from koala3d.datasets.core.schema import Schema, load_yaml
from koala3d.datasets.recording import MANIFEST
from koala3d.reconstruct.models import load_config

Output = Literal["eval", "mesh", "report", "asset", "compare"]
StepName = Literal["build", "mask", "check", "train", "eval", "mesh", "report", "asset", "compare"]
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


class StepNeeds(Schema):
    """What a step occupies on a node of a cluster."""

    cores: float = Field(default=1, gt=0, description="cores of a node that the step occupies")
    memory_gb: float = Field(default=0, ge=0, description="memory that the step occupies [GB]; 0: any")
    gpus: float | None = Field(
        default=None, ge=0, description="share of a GPU; null: one for 'train' if the cluster has any, none for others"
    )

    @model_validator(mode="after")
    def _whole(self) -> Self:
        for name, amount in (("cores", self.cores), ("gpus", self.gpus or 0)):
            if amount > 1 and amount != int(amount):
                raise ValueError(f"{name}: more than one is a whole number")
        return self


class Piece(Schema):
    """An object that has more to it than a path."""

    path: str = Field(min_length=1, description="recording or scene")
    drawing: str | None = Field(default=None, description="mesh that it is compared with, in place of the series' own")
    like: str | None = Field(default=None, description="object of the series that it is compared with, in place of a drawing")


class SeriesFile(Schema):
    """Objects, what they share, and rules."""

    format: Literal["koala-series"] = Field(default="koala-series", description="what this file is")
    version: Literal[1] = Field(default=1, description="version of this format")
    objects: list[str] | dict[str, str | Piece] = Field(
        default=[], description="recordings or scenes, a list (each is called as its folder) or by name"
    )
    calibration: str | None = Field(default=None, description="calibration file, for recordings")
    outputs: list[Output] = Field(default=["eval", "mesh", "report"], description="what is made of each trained object")
    model: str = Field(default="surfnerf", description="model, see 'reconstruct models'")
    preset: str = Field(default="fast", description="fast or paper")
    settings: list[str] = Field(default=[], description="settings of the training, as KEY=VALUE")
    scale: float | None = Field(default=None, gt=0, le=1, description="size of the pictures in training; null: the preset's")
    steps: int | None = Field(default=None, ge=1, description="steps of each training; null: the preset's")
    budget_s: float | None = Field(default=None, gt=0, description="seconds of each training, in place of steps")
    mask: bool = Field(default=True, description="find the object in recordings with 'datasets mask', and train on it alone")
    check: Literal["stop", "go_on", "none"] = Field(
        default="stop", description="what an object does if 'datasets check' finds an error in its scene; none: do not check"
    )
    from_first: bool = Field(default=False, description="begin with the weights of the first object: 'train --from'")
    stands_on: str | None = Field(default=None, description="side of the box that the objects stand on, such as -z")
    drawing: str | None = Field(
        default=None, description="mesh that objects are compared with; null: the first object of the series"
    )
    tolerance_m: float | None = Field(default=None, gt=0, description="deviation that is tolerated [m], for compare")
    needs: dict[StepName, StepNeeds] = Field(default={}, description="what steps occupy on a cluster, by step")

    @field_validator("objects")
    @classmethod
    def _names_are_folders(cls, objects: list[str] | dict[str, str | Piece]) -> list[str] | dict[str, str | Piece]:
        names = list(objects) if isinstance(objects, dict) else [Path(path).name for path in objects]
        for name in names:
            if not NAME.fullmatch(name):
                raise ValueError(f"'{name}' is no name of an object: letters, digits, and . _ - after the first of them")
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"two objects are called '{twice[0]}': give them names, NAME: PATH")
        return objects

    @model_validator(mode="after")
    def _agrees(self) -> Self:
        if self.steps is not None and self.budget_s is not None:
            raise ValueError("steps and budget_s exclude each other: keep one")
        if self.tolerance_m is not None and "compare" not in self.outputs:
            raise ValueError("tolerance_m is for compare: add it to outputs")
        return self

    @property
    def overrides(self) -> list[str]:
        """The settings of a training, those with keys of their own included."""
        own = {"scale": self.scale, "train.steps": self.steps}
        return [*self.settings, *(f"{key}={value:g}" for key, value in own.items() if value is not None)]


@dataclass(frozen=True)
class Item:
    """An object of the series."""

    name: str
    recording: Path | None  # None: there is a scene already
    scene: Path | None
    drawing: Path | None
    like: str | None = None  # name of the object that it is compared with


@dataclass(frozen=True)
class Series:
    """A file that was read."""

    path: Path
    about: SeriesFile
    items: dict[str, Item]
    """Its objects, by name."""

    @property
    def folder(self) -> Path:
        """Where its commands run, and relative paths begin."""
        return self.path.parent

    @property
    def calibration(self) -> Path | None:
        """The file of the calibration."""
        return None if self.about.calibration is None else self.folder / self.about.calibration

    @property
    def inputs(self) -> list[Path]:
        """All that its commands read."""
        of_items = (path for item in self.items.values() for path in (item.recording, item.scene, item.drawing))
        return [self.path, *dict.fromkeys(path for path in (self.calibration, *of_items) if path is not None)]

    def with_recordings(self, found: Mapping[str, Path]) -> "Series":
        """The series with further recordings at its end, by name; those that it has already stay as they are."""
        drawing = None if self.about.drawing is None else self.folder / self.about.drawing
        new = {name: Item(name, path, None, drawing) for name, path in found.items() if name not in self.items}
        return Series(self.path, self.about, {**self.items, **new})


def read(path: Path) -> Series:
    """Read the file of a series. Raises UsageError in one line: a wrong key, a missing file, an unknown model or setting."""
    path = Path(path).absolute()
    about = load_yaml(path, SeriesFile)
    load_config(about.model, about.preset, about.overrides)
    series = Series(path, about, {})
    given = about.objects if isinstance(about.objects, dict) else {Path(name).name: name for name in about.objects}
    for name, one in given.items():
        piece = one if isinstance(one, Piece) else Piece(path=one)
        if piece.like is not None:
            _check_like(name, piece, list(given), path)
        series.items[name] = _item(series, name, piece)
    for key, file in (("calibration", about.calibration), ("drawing", about.drawing)):
        if file is not None and not (path.parent / file).is_file():
            raise UsageError(f"{key}: there is no file '{file}'", where=path, remedy=f"paths are relative to {path.parent}")
    if about.calibration is None:
        needing = next((item.name for item in series.items.values() if item.recording), None)
        if needing is not None:
            raise UsageError("key 'calibration' is missing", where=path, why=f"{needing} is a recording", remedy="add it")
    return series


def _check_like(name: str, piece: Piece, names: list[str], path: Path) -> None:
    """Raise UsageError where an object cannot be compared with the one that it is said to be like."""
    where, others = f"{path}, objects.{name}", [other for other in names if other != name]
    if piece.drawing is not None:
        raise UsageError("drawing and like exclude each other", where=where, remedy="keep one")
    if piece.like not in others:
        raise UsageError(f"like: there is no other object '{piece.like}'", where=where, remedy=nearest(piece.like or "", others))


def _item(series: Series, name: str, piece: Piece) -> Item:
    """An object whose files are there."""
    place, where = series.folder / piece.path, f"{series.path}, objects.{name}"
    if not place.is_dir():
        raise UsageError(f"there is no folder '{piece.path}'", where=where, remedy=f"paths are relative to {series.folder}")
    if piece.drawing is not None and not (series.folder / piece.drawing).is_file():
        raise UsageError(f"there is no drawing '{piece.drawing}'", where=where, remedy=f"paths are relative to {series.folder}")
    recorded = (place / MANIFEST).is_file()
    drawing = None if piece.like is not None else piece.drawing or series.about.drawing
    return Item(
        name,
        place if recorded else None,
        None if recorded else place,
        None if drawing is None else series.folder / drawing,
        piece.like,
    )
