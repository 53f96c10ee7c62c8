"""The step: accumulated batches, gains of views, several devices. That every model trains is in test_every_model."""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from datasets.core.console import progress
from datasets.scene import Scene
from reconstruct import models
from reconstruct.config import Config
from reconstruct.scene.facts import SceneFacts
from reconstruct.scene.rays import Normalisation, Pixels
from reconstruct.training.batches import Division
from reconstruct.training.optimiser import Optimiser
from reconstruct.training.step import Step, TrainState

SMALL = {
    "encoding": {"levels": 3, "log2_size": 8, "coarsest": 2.0, "finest": 16.0},
    "field": {"spatial_width": 16, "view_width": 16, "bottleneck": 4, "ide_degree": 2, "view_depth": 3},
    "sampler": {
        "rays": 64,
        "samples": 512,
        "grid": 16,
        "steps": 32,
        "max_per_ray": 8,
        "proposals": (8, 8),
        "final": 8,
        "proposal_finest": (8.0, 16.0),
    },
    "surface": {"rays": 16, "samples": 8},
}
FACTS = SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.5, 4.0))
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
    one_step = Step.of(config, SceneFacts(normalisation))
    state = start = one_step.initial(jax.random.key(0), None, len(views))
    one = jax.jit(one_step)  # `advance` is a loop around it, which would only be traced and compiled twice
    arguments = (pixels, jnp.asarray(0, jnp.int32), jnp.asarray(0.5), jnp.asarray(True))
    step = one.lower(state, *arguments).compile(compiler_options={"xla_backend_optimization_level": 0})
    for _ in range(steps):
        state, terms = step(state, *arguments)
    return start, state, {name: float(value) for name, value in terms.items()}


def test_accumulated_batches_step_by_their_mean_gradient(monkeypatch: pytest.MonkeyPatch) -> None:
    config = Config.model_validate(models.merged(small("surfnerf_voxels").model_dump(), {"train": {"accumulate": 3}}))
    one_step = Step.of(config, FACTS)
    state = one_step.initial(jax.random.key(0))
    stepped: list = []

    def gradient(self, model, pixels, key, progress, second):
        value = jax.random.uniform(key)
        cell = (1000 * value).astype(jnp.int32)[None]
        return jax.tree.map(lambda leaf: jnp.full_like(leaf, value), model.split()[0]), {"mse": value}, (cell, value[None])

    def descended(self, learned, gradient, moments, *_):
        stepped.append(gradient)
        return learned, moments

    monkeypatch.setattr(Step, "gradient", gradient)
    monkeypatch.setattr(Optimiser, "descended", descended)
    pixels = Pixels(*(jnp.zeros(s) for s in ((1, 4), (1, 3))), jnp.zeros(1, jnp.int32), jnp.zeros((1, 3)), jnp.zeros(1))
    after, terms = one_step(state, pixels, jnp.asarray(5), jnp.asarray(0.5), jnp.asarray(False))
    values = jax.vmap(jax.random.uniform)(jax.random.split(jax.random.fold_in(jax.random.key(5), 0), 3))
    np.testing.assert_allclose(jax.tree.leaves(stepped[0])[0], np.mean(values), rtol=1e-6)
    np.testing.assert_allclose(terms["mse"], np.mean(values), rtol=1e-6)
    known = [np.isfinite(one.model.sampler.grid.density) for one in (after, state)]
    changed = np.flatnonzero(known[0] != known[1])
    assert len(changed) == 0, "densities that are known are kept as maxima: unknown cells stay unknown"


def test_views_of_their_own_exposure_train(ball_scene: tuple[Scene, Path]) -> None:
    config = Config.model_validate(models.merged(small("zipnerf").model_dump(), {"train": {"per_image": "colour"}}))
    one_step = Step.of(config, SceneFacts(Normalisation.of(ball_scene[0])))
    assert one_step.initial(jax.random.key(0), None, 4).model.per_image.shape == (4, 3)
    _, after, _ = stepped(config, ball_scene[0], 3)
    assert np.abs(after.model.per_image).min() > 0, "every view's gains learn"


SHARDED = """
import jax, jax.numpy as jnp, numpy as np
from reconstruct.config import Config
from reconstruct.models import load_config, merged
from reconstruct.scene.facts import SceneFacts
from reconstruct.scene.rays import Normalisation, Pixels
from reconstruct.training.batches import Division
from reconstruct.training.step import Step
from dataclasses import replace
import json, sys

assert len(jax.devices()) == 4
rng = np.random.default_rng(0)
origins = rng.normal(size=(5, 3)); origins *= 3 / np.linalg.norm(origins, axis=-1, keepdims=True)
view = rng.integers(0, 5, 2000)
directions = rng.uniform(-0.5, 0.5, (2000, 3)) - origins[view]
f = lambda a: jnp.asarray(a, jnp.float32)
colour, view = jnp.asarray(rng.random((2000, 4)), jnp.float16), jnp.asarray(view, jnp.int32)
pixels = Pixels(colour, f(directions), view, f(origins), f(np.full(5, 1e-3)))
config = Config.model_validate(merged(load_config("surfnerf").model_dump(), json.loads(sys.argv[1])))
facts = SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, sys.argv[2] == "bounded", 0.5, 6.0))
found = []
for count in (1, 4):
    state = Step.of(config, facts).initial(jax.random.key(0))
    division = Division.among(jax.devices()[:count], state.model.sampler.divided_sizes)
    assert (division.mesh is None) == (count == 1) and (count == 1 or division.mesh.size == 4)
    placed = {}
    if division.everywhere is not None:
        state, pixels = jax.device_put((state, pixels), division.everywhere)
        placed = {"out_shardings": division.everywhere}
    arguments = (jnp.asarray(0, jnp.int32), jnp.asarray(0.5), jnp.asarray(True))
    step = jax.jit(replace(Step.of(config, facts), division=division).__call__, **placed).lower(state, pixels, *arguments)
    step = step.compile(compiler_options={"xla_backend_optimization_level": 0})
    for _ in range(3):
        state, terms = step(state, pixels, *arguments)
    assert len(state.model.field.encoding.table.devices()) == count
    terms = {k: float(v) for k, v in terms.items()}
    found.append((terms, np.asarray(state.model.sampler.grid.density), np.asarray(state.model.field.spatial.weights[0])))
(one, grid, weights), (four, grid4, weights4) = found
for name in one:
    np.testing.assert_allclose(four[name], one[name], rtol=1e-3, atol=1e-6, err_msg=name)
np.testing.assert_allclose(weights4, weights, atol=1e-3)
np.testing.assert_allclose(grid4, grid, rtol=1e-3)
"""


@pytest.mark.parametrize("world", [pytest.param("bounded", marks=pytest.mark.slow), "among surroundings"])
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
    sizes = Step.of(config, FACTS).initial(jax.random.key(0)).model.sampler.divided_sizes
    alone = Division.among([jax.devices()[0]] * 1, sizes)
    assert alone.mesh is None and alone.everywhere is None
    assert Division.among([jax.devices()[0]] * 3, sizes).mesh is None
