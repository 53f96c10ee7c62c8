"""A run on disk: what was trained, on what, with which settings, and where it stands.

RUN/run.json        configuration, scene, facts measured on it, versions
RUN/log.jsonl       one line per look at the training: step, seconds, PSNR, every loss
RUN/events.out.*    the same for TensorBoard, where that was wanted
RUN/checkpoints/    training states
RUN/poses.json      where poses were refined: those of the training views
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from datasets.core import files
from datasets.core.errors import DatasetError, UsageError
from datasets.scene import Scene
from reconstruct.config import Config
from reconstruct.scene.facts import SceneFacts
from reconstruct.scene.rays import Normalisation

FORMAT, VERSION = "koala-run", 1
RUN, LOG, FAULTS, CHECKPOINTS = "run.json", "log.jsonl", "faults.jsonl", "checkpoints"


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

    @classmethod
    def create(cls, path: Path, config: Config, scene_path: Path, facts: SceneFacts, about: dict[str, Any]) -> "Run":
        """Start a run in a folder that is missing or empty."""
        path = Path(path)
        files.refuse_existing(path)
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
            facts = SceneFacts.from_json(content.get("facts") or {"normalisation": content["normalisation"]})
            return cls(path, Config.model_validate(_current(content["config"])), content["scene"], facts, content)
        except (KeyError, TypeError, ValueError) as error:
            raise DatasetError("run is not complete", where=path / RUN, why=str(error).splitlines()[0]) from None

    def scene(self) -> Scene:
        """The scene that it was trained on, with the object's box that was measured for it then."""
        from datasets.formats import load_scene

        scene = load_scene(self.scene_path)
        if "box" not in self.content:
            return scene
        return replace(scene, box=np.asarray(self.content["box"], np.float64), bounds_from=self.content["bounds_from"])

    def log(self) -> list[dict[str, Any]]:
        """The lines of the log; one cut off by a kill is left out."""
        path = self.path / LOG
        lines = path.read_text(encoding="utf-8").split("\n")[:-1] if path.is_file() else []
        return [json.loads(line) for line in lines]

    def append_log(self, line: dict[str, Any]) -> None:
        """Add a line to the log."""
        self._append(LOG, line)

    def append_fault(self, line: dict[str, Any]) -> None:
        """Note steps that were left out because they were not finite."""
        self._append(FAULTS, line)

    def _append(self, name: str, line: dict[str, Any]) -> None:
        with open(self.path / name, "a", encoding="utf-8") as file:
            file.write(json.dumps(line, allow_nan=False, default=float) + "\n")


def _current(config: dict[str, Any]) -> dict[str, Any]:
    """A run's configuration in today's terms.

    At first it counted the points that stand for a frustum. What is measured on a scene was written into it until the facts had a
    place of their own; there it still has effect, as a value that a person gave.
    """
    if "multisamples" not in config["sampler"]:
        return config
    sampler = {**config["sampler"], "frustum": "hexagon" if config["sampler"]["multisamples"] == 6 else "point"}
    del sampler["multisamples"]
    field = {**config["field"], "view_skip": config["field"]["view_depth"] - 1 if config["field"]["view_skip"] else 0}
    return {**config, "sampler": sampler, "field": field}
