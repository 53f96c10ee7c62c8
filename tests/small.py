"""Small models, and a step as training runs it: `Programs`, compiled with the options that ship.

What needs a model that trains takes the fixture `trainable`, or `tests.reconstruct.glossy_ball`: its programs are compiled once.
What needs only a model of some kind takes these sizes.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from koala3d.datasets.core.console import progress
from koala3d.datasets.scene import Scene
from koala3d.reconstruct import models
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from koala3d.reconstruct.training.beginning.starting import start
from koala3d.reconstruct.training.programs import Programs
from koala3d.reconstruct.training.step import Step, TrainState

SIZES: dict[str, dict[str, Any]] = {
    "encoding": {"levels": 3, "log2_size": 8, "coarsest": 2.0, "finest": 16.0},
    "field": {"spatial_width": 16, "view_width": 16, "bottleneck": 4, "ide_degree": 2, "density_bias": 2.0},
    "sampler": {
        "rays": 64,
        "samples": 512,
        "grid": 32,
        "steps": 32,
        "max_per_ray": 8,
        "proposals": (8, 8),
        "final": 8,
        "proposal_finest": (8.0, 16.0),
    },
    "surface": {"rays": 16, "samples": 8},
}
SET = [
    f"{section}.{key}={list(value) if isinstance(value, tuple) else value}"
    for section, values in SIZES.items()
    for key, value in values.items()
]
"""The same as words for `--set`."""


def in_scene(config: Config, facts: SceneFacts) -> Config:
    """A configuration resolved for a scene whose kind its normalisation tells."""
    return models.of_kinds(config, ["blank" if facts.normalisation.bounded else "surroundings"])


def small(model: str = "surfnerf", preset: str = "fast", changes: Mapping[str, Any] | None = None) -> Config:
    """A model of these sizes, with further changes by section."""
    return models.merged_config(models.merged_config(models.load_config(model, preset), SIZES), dict(changes or {}))


def pixels_of(scene: Scene, normalisation: Normalisation) -> Pixels:
    """Those of a scene's training views."""
    views = scene.split("train")
    with progress("reading", len(views)) as shown:
        return Pixels.load(views, normalisation, 1.0, shown)


@dataclass(frozen=True)
class Trainable:
    """A compiled step, pixels for it, and the state to begin with."""

    step: Step
    pixels: Pixels
    start: TrainState
    programs: Programs

    @classmethod
    def of(cls, config: Config, facts: SceneFacts, pixels: Pixels) -> "Trainable":
        """A step for a configuration, compiled."""
        step = Step.of(in_scene(config, facts), facts)
        start = step.initial(jax.random.key(0), None, len(pixels.origins))
        return cls(step, pixels, start, step.compiled(start, pixels))

    @classmethod
    def prepared(cls, scene: Scene, folder: Path, config: Config, run: Path) -> "Trainable":
        """A step on a scene in a folder as `reconstruct train` prepares it, in a new run."""
        training = start(scene, folder, config, run)
        programs = training.one_step.compiled(training.state, training.pixels)
        return cls(training.one_step, training.pixels, training.state, programs)

    @classmethod
    def on(cls, config: Config, scene: Scene) -> "Trainable":
        """A step on a scene's training views."""
        normalisation = Normalisation.of(scene)
        return cls.of(config, SceneFacts(normalisation), pixels_of(scene, normalisation))

    def trained(
        self,
        steps: int,
        start: TrainState | None = None,
        *,
        seed: int = 0,
        second: Callable[[int], bool] = lambda index: True,
        done: Callable[[int], float] = lambda index: 0.5,
    ) -> tuple[TrainState, list[dict[str, float]]]:
        """The state after a number of steps from `start` (or this one's), and the terms of each.

        Args:
            second: whether a step has the regularisers' second pass, by its index.
            done: how much of the training is done, by a step's index.
        """
        state, lines = jax.tree.map(jnp.copy, self.start if start is None else start), []  # programs use up their state
        for index in range(steps):
            progress = jnp.asarray(done(index), jnp.float32)
            state, terms = self.programs(
                state, self.pixels, jnp.asarray(seed, jnp.int32), progress, 1, second(index), jnp.asarray(True)
            )
            lines.append(terms)
        return state, [{name: float(value) for name, value in line.items()} for line in lines]
