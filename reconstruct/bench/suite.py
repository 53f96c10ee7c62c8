"""What the benchmark trains: frozen lists, so that two results can be laid beside each other.

Each trial is one training whose schedules end with its budget, as those of `reconstruct train --budget` do: a longer
training is worse at the same moment, because its schedules are not finished.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from koala3d.datasets.core.errors import UsageError, nearest
from koala3d.datasets.formats import find
from koala3d.reconstruct.rendered import make
from koala3d.reconstruct.rendered.near.scenes import NEAR
from koala3d.reconstruct.rendered.shiny import SCENES
from koala3d.reconstruct.rendered.stages import BENCHMARK

QUALITY, COST = "quality", "cost"
"""Kinds of trials: error after a budget; time and memory for a number of images."""
BUDGETS_S = (15.0, 30.0, 60.0, 120.0, 300.0)
REAL = ("lego400", "mold_gold_cape")  # scenes that are used if they are found


@dataclass(frozen=True)
class Trial:
    """One training."""

    kind: str
    scene: str
    scale: float  # images are resampled by this factor
    views: int  # number of training views; 0 for all
    model: str
    preset: str
    budget_s: float
    seed: int

    @property
    def key(self) -> tuple[str, ...]:
        """Identifies the trial, as text."""
        return tuple(f"{value:g}" if isinstance(value, float) else str(value) for value in asdict(self).values())

    @property
    def name(self) -> str:
        """The key as the name of a folder."""
        return "-".join(self.key)


@dataclass(frozen=True)
class Block:
    """All combinations of the listed values."""

    scenes: tuple[tuple[str, float], ...]  # name and scale
    models: tuple[str, ...] = ("surfnerf",)
    presets: tuple[str, ...] = ("fast",)
    budgets_s: tuple[float, ...] = BUDGETS_S
    seeds: tuple[int, ...] = (0, 1, 2)
    kind: str = QUALITY
    views: tuple[int, ...] = (0,)

    def trials(self) -> list[Trial]:
        """The trials, shortest first and seed by seed, so that an interrupted benchmark has results."""
        every = product(self.seeds, self.budgets_s, self.scenes, self.models, self.presets, self.views)
        return [Trial(self.kind, *scene, views, model, preset, budget, s) for s, budget, scene, model, preset, views in every]


SHINY, UNDER_NEAR_LAMPS = (tuple((name, 1.0) for name in names) for names in (SCENES, NEAR))
LEGO, CAPE = tuple(("lego400", scale) for scale in (0.25, 0.5, 1.0)), ("mold_gold_cape", 0.5)
SUITES: dict[str, tuple[Block, ...]] = {
    "quick": (
        Block((("gold_rings", 1.0), ("lego400", 0.5)), budgets_s=(15.0, 30.0), seeds=(0, 1)),
        Block((("gold_rings", 1.0),), models=("lattice_refnerf",), budgets_s=(15.0, 30.0), seeds=(0,)),
        Block((("lego400", 0.25), ("lego400", 0.5)), budgets_s=(5.0,), seeds=(0,), kind=COST, views=(50, 0)),
    ),
    "full": (
        Block((*SHINY, *LEGO[1:], CAPE), models=("surfnerf", "lattice_refnerf", "zip_refnerf", "zipnerf")),
        Block(UNDER_NEAR_LAMPS, models=("surfnerf", "zip_refnerf_published"), budgets_s=(60.0, 120.0)),
        Block((("gold_rings", 1.0), ("lego400", 0.5)), presets=("paper",), budgets_s=(300.0,), seeds=(0,)),
        Block(LEGO, budgets_s=(10.0,), seeds=(0, 1), kind=COST, views=(25, 50, 0)),
    ),
}
"""quick: within ten minutes on two cores. full: about twenty hours."""


@dataclass(frozen=True)
class Choice:
    """Selection from a suite; empty selects all."""

    scenes: tuple[str, ...] = ()
    scales: tuple[float, ...] = ()
    models: tuple[str, ...] = ()
    presets: tuple[str, ...] = ()
    budgets_s: tuple[float, ...] = ()
    seeds: tuple[int, ...] = ()


def plan(suite: str, choice: Choice = Choice()) -> list[Trial]:
    """The selected trials of a suite. Models and budgets that it lacks are added.

    Raises UsageError: unknown suite or scene, or no trial has that scale or preset.
    """
    if suite not in SUITES:
        raise UsageError(f"there is no suite '{suite}'", where="--suite", remedy=nearest(suite, SUITES))
    blocks = SUITES[suite]
    known = dict.fromkeys(name for block in blocks for name, _ in block.scenes) | dict.fromkeys(BENCHMARK)
    for name in choice.scenes:
        if name not in known:
            raise UsageError(f"there is no scene '{name}'", where="--scene", remedy=nearest(name, known))
    trials = dict.fromkeys(trial for block in _chosen(blocks, choice) for trial in block.trials())
    if not trials:
        scales = sorted({f"{scale:g}" for block in blocks for _, scale in block.scenes})
        presets = sorted({preset for block in blocks for preset in block.presets})
        why = f"scales are {', '.join(scales)}, presets {', '.join(presets)}"
        raise UsageError(f"suite {suite} has no such trial", where="--scale, --preset", why=why, remedy="choose among these")
    return sorted(trials, key=lambda trial: trial.seed)


def _chosen(blocks: Sequence[Block], choice: Choice) -> list[Block]:
    """The blocks with the chosen values instead of their own; blocks of other kinds than `QUALITY` only without a choice."""
    if choice == Choice():
        return list(blocks)
    found = []
    for block in blocks:
        presets = tuple(preset for preset in block.presets if not choice.presets or preset in choice.presets)
        if block.kind != QUALITY or not presets:
            continue
        named = tuple(scene for scene in block.scenes if not choice.scenes or scene[0] in choice.scenes)
        missing = tuple((name, 1.0) for name in choice.scenes if name in BENCHMARK and name not in dict(block.scenes))
        sized = tuple(scene for scene in named + missing if not choice.scales or scene[1] in choice.scales)
        lists = {name: getattr(choice, name) or getattr(block, name) for name in ("models", "budgets_s", "seeds")}
        found.append(replace(block, scenes=sized, presets=presets, **lists))
    return [block for block in found if block.scenes]


def folders(trials: Sequence[Trial], made_in: Path, data: Path | None, rendered: Any = None) -> dict[str, Path]:
    """Folder of each scene that is found. Missing rendered scenes are made.

    Args:
        made_in: folder of the rendered scenes.
        data: folder of the real scenes; default: the usual places.
        rendered: called with the name of each scene before it is rendered.
    """
    found = {}
    for name in dict.fromkeys(trial.scene for trial in trials):
        if name in BENCHMARK:
            place = made_in / f"{name}-{make.EDITION}"
            if rendered is not None and not place.exists():
                rendered(name)
            make.provide(name, place)
            found[name] = place
            continue
        try:
            found[name] = find(name, data)
        except UsageError:
            continue
    return found
