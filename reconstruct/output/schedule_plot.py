"""The schedule of a training as a drawing: each quantity that follows progress, relative to its largest value."""

import jax
import numpy as np

from koala3d.datasets.reports.drawing import COLOURS, blank, svg_of
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.training.schedule import Schedule

PLACES = 401
"""Shares of the training at which the curves are drawn."""


def drawn(config: Config) -> str:
    """The drawing as SVG; what a configuration has not is left out."""
    schedule, losses = Schedule(config), config.losses
    curves = {"learning rate": schedule.rate, "blur of samples": schedule.blur}
    if config.field.matter == "solid":
        curves["freedom of the shape"] = schedule.gain
    if losses.hollowness:
        curves["hollowness"] = schedule.hollowness
    if losses.fog:
        curves["fog"] = schedule.fog
    if losses.density_normals or losses.last_density_normals:
        curves["density follows normals"] = schedule.density_normals
    if config.surface.enabled and config.surface.bias:
        curves["Lambertian bias"] = schedule.bias
    progress = np.linspace(0, 1, PLACES, dtype=np.float32)
    figure = blank(8, 0.42 * (len(curves) + 1) + 0.7)
    axes = figure.add_subplot()
    values = {name: np.broadcast_to(jax.vmap(curve)(progress), PLACES) for name, curve in curves.items()}
    if config.surface.enabled:
        values["second passes"] = 1 / np.array([schedule.second_pass_period(place) for place in progress])
    for row, curve in enumerate(values.values()):
        height = 0.8 * curve / max(float(curve.max()), 1e-30)
        axes.fill_between(100 * progress, -row, height - row, color=COLOURS[row % len(COLOURS)], alpha=0.5, linewidth=0)
        axes.plot(100 * progress, height - row, color=COLOURS[row % len(COLOURS)], linewidth=1)
    axes.set(xlabel="share of the training [%]", xlim=(0, 100), yticks=[0.3 - row for row in range(len(values))])
    axes.set_yticklabels(list(values))
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", alpha=0.25)
    axes.spines[["top", "right", "left"]].set_visible(False)
    return svg_of(figure)
