"""How many of the first surfaces that a training uses are where the surface is, by each rule, on a scene of known shape."""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.scene import Scene
from koala3d.reconstruct.bench.scenes.shiny import RADIUS_M
from koala3d.reconstruct.bench.scenes.tracer import Tracer
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.rendering.model import render
from koala3d.reconstruct.sampling.samples import cloud_of
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.surface.first_surface import RULES, find_surfaces
from koala3d.reconstruct.training.batches import ONE_DEVICE, drawn_batch
from koala3d.reconstruct.training.beginning.starting import start
from koala3d.reconstruct.training.training import Training

SHARES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0)
"""Of the training, at which is looked."""
RAYS = 2048
"""Rays with a surface that are looked at, at most."""
PIXELS = 2.0
"""A surface within so many pixels' widths of the true one counts as right."""


@dataclass(frozen=True)
class Seen:
    """What one rule found at one step."""

    step: int
    rule: str
    rays: int
    right: float
    """Share within `PIXELS` of the truth."""
    error_pixels: float
    """Median distance from it."""


def watch(scene: Scene, scene_path: Path, tracer: Tracer, config: Config) -> list[Seen]:
    """Train a scene of the benchmark in a temporary folder, and compare all rules on the way."""
    width_m = 1 / (config.scale * scene.views[0].camera.fx)
    with tempfile.TemporaryDirectory(prefix="koala-surfaces-") as folder:
        training = start(scene, scene_path, config, Path(folder) / "run")
        training.compile()
        found: list[Seen] = []
        for share in SHARES:
            while training.clock.progress < share:
                training.chunk()
            found += _compared(training, tracer, width_m)
    return found


def _compared(training: Training, tracer: Tracer, width_m: float) -> list[Seen]:
    """All rules on one batch of the model as it is; nothing while no ray has a surface."""
    model, normalisation = training.state.model, training.run.normalisation
    pixel_key, batch_key, sample_key = jax.random.split(jax.random.key(training.clock.step), 3)
    batch = drawn_batch(model, training.pixels, pixel_key, batch_key, ONE_DEVICE)
    drawn = model.sampler.sampled(batch, sample_key)
    cloud = cloud_of(batch.rays, drawn.samples, space=normalisation.space, footprint=drawn.footprint)
    rendered, _ = render(model.field, batch.rays, drawn.samples, cloud)
    result = []
    for rule in RULES:
        surface = find_surfaces(rendered.weights, drawn.samples, batch.rays.radii, RAYS, rule)
        real = np.asarray(surface.weight > 0)
        chosen = np.asarray(surface.ray)[real]
        origins, directions = (np.asarray(values)[chosen] for values in (batch.rays.origins, batch.rays.directions))
        if not len(chosen):
            continue
        off = _off_by(np.asarray(surface.t)[real], origins, directions, tracer, normalisation, width_m)
        result.append(Seen(training.clock.step, rule, len(off), float(np.mean(off <= PIXELS)), float(np.median(off))))
    return result


def _off_by(
    t: NDArray[Any], origins: NDArray[Any], directions: NDArray[Any], tracer: Tracer, normalisation: Normalisation, width_m: float
) -> NDArray[np.float64]:
    """Distance between surfaces at `t` and the true ones, in pixels' widths there; infinite where the ray truly misses."""
    speed = np.linalg.norm(directions, axis=-1)
    from_centre = origins / normalisation.scale + np.asarray(normalisation.centre)
    true = tracer.cast(from_centre / RADIUS_M, directions / speed[:, None]) * RADIUS_M
    metres = t * speed / normalisation.scale
    return np.where(true > 0, np.abs(metres - true) / (np.maximum(true, 1e-6) * width_m), np.inf)


def table(found: list[Seen]) -> str:
    """Share of right surfaces, one line per step."""
    lines = ["   step  " + "".join(f"{rule:>22}" for rule in RULES)]
    for step in dict.fromkeys(seen.step for seen in found):
        cells = (f"{seen.right:7.1%} {seen.error_pixels:8.1f} px" for seen in found if seen.step == step)
        lines.append(f"{step:7d}  " + "".join(f"{cell:>22}" for cell in cells))
    return "\n".join(lines)
