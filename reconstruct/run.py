"""A run on disk: what was trained, on what, with which settings, and where it stands.

RUN/run.json        configuration, scene, facts measured on it, versions
RUN/skips.json      what is left out of the training, and why
RUN/log.jsonl       one line per look at the training: step, seconds, PSNR, every loss
RUN/events.out.*    the same for TensorBoard, where that was wanted
RUN/checkpoints/    training states
RUN/poses.json      where poses were refined: those of the training views
RUN/../.koala-pictures/   large pictures at the scale of the training, for all runs in this folder
"""

import json
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.imaging.copies import Copies
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation

FORMAT, VERSION = "koala-run", 1
RUN, LOG, FAULTS, CHECKPOINTS, SKIPS = "run.json", "log.jsonl", "faults.jsonl", "checkpoints", "skips.json"
GONE = {("train", "accumulate"): 1}
"""Settings that runs of earlier versions have, with the value at which they changed nothing."""
PICTURES = ".koala-pictures"
"""Folder beside a run; everything in it may be deleted."""


def copies_beside(run: Path) -> Copies:
    """Where the pictures of a run are kept, which need not exist yet."""
    return Copies(Path(run).absolute().parent / PICTURES)


@dataclass(frozen=True)
class Run:
    """One training of one scene."""

    path: Path
    config: Config
    scene_path: str
    facts: SceneFacts
    content: dict[str, Any]
    """Everything in run.json."""

    @property
    def normalisation(self) -> Normalisation:
        """Of the scene."""
        return self.facts.normalisation

    @property
    def copies(self) -> Copies:
        """Of the scene's pictures."""
        return copies_beside(self.path)

    @classmethod
    def create(cls, path: Path, config: Config, scene_path: Path, facts: SceneFacts, about: dict[str, Any]) -> "Run":
        """Write run.json, which makes a folder a run; whatever a run needs from its start is in the folder before."""
        path = Path(path)
        content = {
            "format": FORMAT,
            "version": VERSION,
            "scene": str(Path(scene_path).resolve()),
            "config": config.model_dump(mode="json"),
            "facts": facts.to_json(),
            **about,
        }
        files.write_json(path / RUN, content)
        return cls(path, config, content["scene"], facts, content)

    @staticmethod
    def never_begun(path: Path) -> bool:
        """Whether a folder holds only what a training leaves that is killed before it has written run.json; removes that."""
        found = list(Path(path).iterdir())
        if not all(file.name == SKIPS or file.name.startswith((".run.", ".skips.")) for file in found):
            return False
        for file in found:
            file.unlink()
        return True

    @classmethod
    def open(cls, path: Path) -> "Run":
        """Read a run. Raises UsageError where `path` is none."""
        path = Path(path)
        if not (path / RUN).is_file():
            raise UsageError(
                "is not a run", where=path, why=f"no {RUN} in it", remedy="give a folder made by 'reconstruct train'"
            )
        content = files.read_json(path / RUN, kind=FORMAT, version=VERSION)
        try:
            facts = SceneFacts.from_json(content["facts"])
            for (section, key), idle in GONE.items():
                if content["config"][section].get(key) == idle:
                    del content["config"][section][key]
            config = Config.model_validate(content["config"])
            return cls(path, config, content["scene"], facts, content)
        except (KeyError, TypeError, ValueError) as error:
            raise DatasetError("run is not complete", where=path / RUN, why=str(error).splitlines()[0]) from None

    def scene(self) -> Scene:
        """The scene that it was trained on, with the object's box that was measured for it then."""
        from koala3d.datasets.formats import load_scene

        scene = load_scene(self.scene_path)
        if "box" not in self.content:
            return scene
        return replace(scene, box=np.asarray(self.content["box"], np.float64), bounds_from=self.content["bounds_from"])

    def log(self) -> list[dict[str, Any]]:
        """The lines of the log; one cut off by a kill or a full disk is left out. Raises DatasetError where one is damaged."""
        lines = []
        for number, line in enumerate(_complete(self.path / LOG).splitlines(), 1):
            try:
                lines.append(dict(json.loads(line)))
            except (ValueError, TypeError, RecursionError) as error:  # ValueError: neither UTF-8 nor JSON
                where, remedy = f"{self.path / LOG}, line {number}", "remove the line"
                raise DatasetError("line is damaged", where=where, why=str(error), remedy=remedy) from None
        return lines

    def amend(self, more: dict[str, Any]) -> None:
        """Add to run.json what is known only after the run was made."""
        self.content.update(more)
        files.write_json(self.path / RUN, self.content)

    def append_log(self, line: dict[str, Any]) -> None:
        """Add a line to the log; on the disk when this returns."""
        _append(self.path / LOG, line)

    def append_fault(self, line: dict[str, Any]) -> None:
        """Note steps that were left out because they were not finite."""
        _append(self.path / FAULTS, line)

    def rewind(self, step: int) -> None:
        """Drop what was logged after a step: a resumed training takes those steps again."""
        log = self.log()
        kept = [line for line in log if line.get("step", 0) <= step]
        if len(kept) < len(log):
            files.write_text(self.path / LOG, "".join(json.dumps(line) + "\n" for line in kept))


def _complete(path: Path) -> bytes:
    """The complete lines of a file, without what a kill, a power cut or a full disk left behind the last of them."""
    content = path.read_bytes() if path.is_file() else b""
    return content[: content.rfind(b"\n") + 1]


def _append(path: Path, line: dict[str, Any]) -> None:
    """Add a line to a file and flush it, in place of an incomplete one at its end."""
    data, end, new = json.dumps(line, allow_nan=False, default=float) + "\n", len(_complete(path)), not path.exists()
    with open(path, "w+b" if new else "r+b") as file:
        file.truncate(end)
        file.seek(end)
        file.write(data.encode())
        file.flush()
        os.fsync(file.fileno())
    if new:
        files.flush(path.parent)
