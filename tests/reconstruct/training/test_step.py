"""Every model takes steps: the parts fit together whichever encoding, appearance, sampler and regularisers they are."""

import json
import os
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from datasets.core.console import progress
from datasets.scene import Scene
from reconstruct import models
from reconstruct.config import Config
from reconstruct.scene.rays import Normalisation, Pixels
from reconstruct.training.step import StepFunctions, TrainState

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
    state = start = functions.initial(jax.random.key(0), None, len(views))
    one = jax.jit(functions._step)  # `advance` is a loop around it, which would only be traced and compiled twice
    arguments = (pixels, jnp.asarray(0, jnp.int32), jnp.asarray(0.5), jnp.asarray(True))
    step = one.lower(state, *arguments).compile(compiler_options={"xla_backend_optimization_level": 0})
    for _ in range(steps):
        state, terms = step(state, *arguments)
    return start, state, {name: float(value) for name, value in terms.items()}


ALWAYS = ("surfnerf", "surfnerf_voxels", "refnerf", "mipnerf", "finetune")
"""Models that between them use every encoding, appearance and pass; the others are other combinations of these."""


@pytest.mark.parametrize(
    "model", [name if name in ALWAYS else pytest.param(name, marks=pytest.mark.slow) for name in models.names()]
)
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


def test_accumulated_batches_step_by_their_mean_gradient(monkeypatch: pytest.MonkeyPatch) -> None:
    config = Config.model_validate(models.merged(small("surfnerf_voxels").model_dump(), {"train": {"accumulate": 3}}))
    functions = StepFunctions(config, Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.5, 4.0))
    state = functions.initial(jax.random.key(0), None)
    stepped: list = []

    def batch(self, state: TrainState, pixels, key, progress, second):
        value = jax.random.uniform(key)
        cell = (1000 * value).astype(jnp.int32)[None]
        return jax.tree.map(lambda leaf: jnp.full_like(leaf, value), state.model), {"mse": value}, (cell, value[None])

    monkeypatch.setattr(StepFunctions, "_batch", batch)
    monkeypatch.setattr(StepFunctions, "_descend", lambda self, state, gradient, *_: stepped.append(gradient) or state)
    after, terms = functions._step(state, None, jnp.asarray(5), jnp.asarray(0.5), jnp.asarray(False))
    values = jax.vmap(jax.random.uniform)(jax.random.split(jax.random.fold_in(jax.random.key(5), 0), 3))
    np.testing.assert_allclose(jax.tree.leaves(stepped[0])[0], np.mean(values), rtol=1e-6)
    np.testing.assert_allclose(terms["mse"], np.mean(values), rtol=1e-6)
    changed = np.flatnonzero(np.isfinite(after.occupancy.density) != np.isfinite(state.occupancy.density))
    assert len(changed) == 0, "densities that are known are kept as maxima: unknown cells stay unknown"


def test_views_of_their_own_exposure_train(ball_scene: tuple[Scene, Path]) -> None:
    config = Config.model_validate(models.merged(small("zipnerf").model_dump(), {"train": {"per_image": "colour"}}))
    functions = StepFunctions(config, Normalisation.of(ball_scene[0]))
    assert functions.initial(jax.random.key(0), None, 4).model.per_image.shape == (4, 3)
    _, after, _ = stepped(config, ball_scene[0], 3)
    assert np.abs(after.model.per_image).min() > 0, "every view's gains learn"


SHARDED = """
import jax, jax.numpy as jnp, numpy as np
from reconstruct.config import Config
from reconstruct.models import load_config, merged
from reconstruct.rays import Normalisation, Pixels
from reconstruct.step import StepFunctions
import json, sys

assert len(jax.devices()) == 4
rng = np.random.default_rng(0)
origins = rng.normal(size=(5, 3)); origins *= 3 / np.linalg.norm(origins, axis=-1, keepdims=True)
view = rng.integers(0, 5, 2000)
directions = rng.uniform(-0.5, 0.5, (2000, 3)) - origins[view]
f = lambda a: jnp.asarray(a, jnp.float32)
pixels = Pixels(jnp.asarray(rng.random((2000, 4)), jnp.float16), f(directions), jnp.asarray(view, jnp.int32), f(origins), f(np.full(5, 1e-3)))
config = Config.model_validate(merged(load_config("surfnerf").model_dump(), json.loads(sys.argv[1])))
normalisation = Normalisation((0.0, 0.0, 0.0), 1.0, sys.argv[2] == "bounded", 0.5, 6.0)
found = []
for count in (1, 4):
    functions = StepFunctions(config, normalisation).over(jax.devices()[:count])
    assert (functions.mesh is None) == (count == 1) and (count == 1 or functions.mesh.size == 4)
    state = functions.initial(jax.random.key(0), None)
    placed = {}
    if functions.everywhere is not None:
        state, pixels = jax.device_put((state, pixels), functions.everywhere)
        placed = {"out_shardings": functions.everywhere}
    arguments = (jnp.asarray(0, jnp.int32), jnp.asarray(0.5), jnp.asarray(True))
    step = jax.jit(functions._step, **placed).lower(state, pixels, *arguments)
    step = step.compile(compiler_options={"xla_backend_optimization_level": 0})
    for _ in range(3):
        state, terms = step(state, pixels, *arguments)
    assert len(state.model.field.encoding.table.devices()) == count
    found.append(({k: float(v) for k, v in terms.items()}, np.asarray(state.occupancy.density), np.asarray(state.model.field.spatial.weights[0])))
(one, grid, weights), (four, grid4, weights4) = found
for name in one:
    np.testing.assert_allclose(four[name], one[name], rtol=1e-3, atol=1e-6, err_msg=name)
np.testing.assert_allclose(weights4, weights, atol=1e-3)
np.testing.assert_allclose(grid4, grid, rtol=1e-3)
"""


@pytest.mark.parametrize("world", ["bounded", "among surroundings"])
def test_four_devices_come_to_the_result_of_one(world: str) -> None:
    """Three steps: sums over rays in another order, which Adam's normalisation makes larger: hence a thousandth, not 1e-6."""
    small = models.merged(SMALL, {"field": {"half_box": [0.5, 0.5, 0.5]}, "sampler": {"candidates": 4}})
    environment = {**os.environ, "XLA_FLAGS": "--xla_force_host_platform_device_count=4", "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(
        [sys.executable, "-c", SHARDED, json.dumps(small), world], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-3000:]


def test_devices_that_do_not_divide_a_batch_are_left_out() -> None:
    config = small("surfnerf_voxels")  # 64 rays, 512 samples
    functions = StepFunctions(config, Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.5, 4.0))
    assert functions.over([jax.devices()[0]] * 1).mesh is None and functions.everywhere is None
    assert functions.over([jax.devices()[0]] * 3).mesh is None
