"""Every model takes steps: the parts fit together whichever encoding, appearance, sampler and regularisers they are."""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from datasets.console import progress
from datasets.scene import Scene
from reconstruct import models
from reconstruct.config import Config
from reconstruct.rays import Normalisation, Pixels
from reconstruct.step import StepFunctions, TrainState

SMALL = {
    "encoding": {"levels": 3, "log2_size": 8, "coarsest": 2.0, "finest": 16.0},
    "field": {"spatial_width": 16, "view_width": 16, "bottleneck": 4, "ide_degree": 2, "view_depth": 3},
    "sampler": {"rays": 64, "samples": 512, "grid": 16, "steps": 32, "max_per_ray": 8, "proposals": (8, 8), "final": 8,
                "proposal_finest": (8.0, 16.0)},
    "surface": {"rays": 16, "samples": 8},
}  # fmt: skip
PROPOSAL = {"surfnerf", "mipnerf", "zip_refnerf"}
"""Tested with their paper preset, which together has every kind of frustum; the others with the fast one."""


def small(model: str) -> Config:
    config = models.load_config(model, "paper" if model in PROPOSAL else "fast")
    return Config.model_validate(models.merged(config.model_dump(), SMALL))


def stepped(config: Config, scene: Scene, steps: int) -> tuple[TrainState, TrainState, dict[str, float]]:
    """State before and after `steps` steps, each with the second pass, and the last one's terms."""
    normalisation = Normalisation.of(scene)
    views = scene.split("train")
    with progress("reading", len(views)) as shown:
        pixels = Pixels.load(views, normalisation, 1.0, shown)
    functions = StepFunctions(config, normalisation)
    state = start = functions.initial(jax.random.key(0), None)
    one = jax.jit(functions._step)  # `advance` is a loop around it, which would only be traced and compiled twice
    arguments = (pixels, jnp.asarray(0, jnp.int32), jnp.asarray(0.5), jnp.asarray(True))
    step = one.lower(state, *arguments).compile(compiler_options={"xla_backend_optimization_level": 0})
    for _ in range(steps):
        state, terms = step(state, *arguments)
    return start, state, {name: float(value) for name, value in terms.items()}


@pytest.mark.parametrize("model", models.names())
def test_every_model_trains(model: str, ball_scene: tuple[Scene, Path]) -> None:
    config = small(model)
    before, after, terms = stepped(config, ball_scene[0], 6)
    assert int(after.step) == 6 and int(after.skipped) == 0
    assert all(np.isfinite(value) for value in terms.values())
    arrays = eqx.filter(after.model, eqx.is_inexact_array)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(arrays))
    pairs = zip(jax.tree.leaves_with_path(before.model), jax.tree.leaves(after.model), strict=True)
    still = [jax.tree_util.keystr(path) for (path, a), b in pairs if np.array_equal(a, b)]
    assert not [path for path in still if "blur" not in path and "proposals" not in path], "every parameter takes part"
    regularised, diffuse = config.surface.enabled, after.model.field.appearance.has_diffuse
    expected = {"density_smoothness", "normal_consistency", "specular_variation"} if regularised else set()
    expected |= {"lambertian_bias"} if regularised and diffuse and config.surface.bias else set()
    assert expected == terms.keys() & {"density_smoothness", "normal_consistency", "specular_variation", "lambertian_bias"}
    assert ("predicted_normals" in terms) == after.model.field.appearance.predicts_normals
