"""Targets of the fast preset on two cores, and whether a benchmark meets them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from koala3d.reconstruct.bench.records import Row
from koala3d.reconstruct.output.metric_names import HIGHER_IS_BETTER
from koala3d.reconstruct.rendered.shiny import SCENES


@dataclass(frozen=True)
class Target:
    """A value to be reached after a budget, as the mean over scenes and seeds."""

    name: str
    scenes: tuple[str, ...]
    scale: float
    budget_s: float
    metric: str
    value: float


SHINY = tuple(SCENES)
TARGETS = (
    Target("lego at 200x200 after 60 s", ("lego400",), 0.5, 60, "psnr", 29.0),
    Target("lego at 200x200 after 120 s", ("lego400",), 0.5, 120, "psnr", 31.0),
    Target("lego at 400x400 after 300 s", ("lego400",), 1.0, 300, "psnr", 31.0),
    Target("density normals, shiny scenes at 200x200 after 120 s", SHINY, 1.0, 120, "normal_mae_alpha_acc_deg", 8.0),
    Target("density normals, weighted by alpha only", SHINY, 1.0, 120, "normal_mae_deg", 8.0),
    Target("predicted normals, shiny scenes at 200x200 after 120 s", SHINY, 1.0, 120, "normal_pred_mae_alpha_acc_deg", 8.0),
    Target("rendering a view of 200x200, lego", ("lego400",), 0.5, 60, "seconds", 0.5),
)
"""For the model surfnerf; mean over the test views."""


@dataclass(frozen=True)
class Outcome:
    """A target and the value that was reached."""

    target: Target
    reached: float | None  # mean over the measured scenes and seeds
    scenes: tuple[str, ...]  # the measured ones
    seeds: int  # smallest number of seeds over these scenes

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None if some scenes were not measured."""
        if self.reached is None or len(self.scenes) < len(self.target.scenes):
            return None
        higher = self.target.metric in HIGHER_IS_BETTER
        return self.reached >= self.target.value if higher else self.reached <= self.target.value


def outcomes(rows: Sequence[Row], model: str = "surfnerf", preset: str = "fast") -> list[Outcome]:
    """Outcomes of the targets for which anything was measured."""
    found = []
    for target in TARGETS:
        by_scene: dict[str, list[float]] = {}
        for row in rows:
            place = (row["kind"], row["model"], row["preset"], row["scale"], row["budget_s"])
            if place != ("quality", model, preset, target.scale, target.budget_s) or row["scene"] not in target.scenes:
                continue
            if (value := row.get(target.metric)) is not None:
                by_scene.setdefault(row["scene"], []).append(value)
        if by_scene:
            reached = float(np.mean([np.mean(values) for values in by_scene.values()]))
            found.append(Outcome(target, reached, tuple(by_scene), min(map(len, by_scene.values()))))
    return found
