"""The step: accumulated batches, gains of views, several devices. That every model trains is in test_every_model."""

import json
import math
import os
import re
import subprocess
import sys
from dataclasses import replace
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
from reconstruct.surface.second_pass import SecondPass
from reconstruct.training.batches import Division
from reconstruct.training.optimiser import Optimiser
from reconstruct.training.programs import Programs
from reconstruct.training.step import Part, Step, TrainState

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
    one_step = replace(Step.of(config, FACTS), second_pass=None)
    state = one_step.initial(jax.random.key(0))
    stepped: list = []

    def begun(self, model, step, pixels, seed, progress, index):
        value = jax.random.uniform(self._keys(step, seed, index)["pixels"])
        cell = (1000 * value).astype(jnp.int32)[None]
        gradient = jax.tree.map(lambda leaf: jnp.full_like(leaf, value), model.split()[0])
        return Part(gradient, {"mse": value}, (cell, value[None]), None, None)

    def descended(self, learned, gradient, moments, *_):
        stepped.append(gradient)
        return learned, moments

    monkeypatch.setattr(Step, "begun", begun)
    monkeypatch.setattr(Optimiser, "descended", descended)
    pixels = Pixels(*(jnp.zeros(s) for s in ((1, 4), (1, 3))), jnp.zeros(1, jnp.int32), jnp.zeros((1, 3)), jnp.zeros(1))
    after, terms = one_step(state, pixels, jnp.asarray(5), jnp.asarray(0.5), jnp.asarray(False))
    keys = jax.random.split(jax.random.fold_in(jax.random.key(5), 0), 3)
    values = [jax.random.uniform(jax.random.split(key, 4)[0]) for key in keys]
    np.testing.assert_allclose(jax.tree.leaves(stepped[0])[0], np.mean(values), rtol=1e-6)
    np.testing.assert_allclose(terms["mse"], np.mean(values), rtol=1e-6)
    known = [np.isfinite(one.model.sampler.grid.density) for one in (after, state)]
    changed = np.flatnonzero(known[0] != known[1])
    assert len(changed) == 0, "densities that are known are kept as maxima: unknown cells stay unknown"


def test_the_bias_at_an_object_waits_until_two_fifths_of_the_training(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SecondPass, "terms", lambda _, field, rays, surfaces, key, formed: {"lambertian_bias": formed})
    step = Step.of(small("surfnerf"), FACTS)
    model = step.initial(jax.random.key(0)).model
    part = Part(jax.tree.map(jnp.zeros_like, model.split()[0]), {"mse": jnp.zeros(())}, None, None, None)
    zero, times = jnp.asarray(0), jnp.array([0.0, 0.4, 0.45, 0.5, 1.0])
    waited = [step.regularised(model, zero, part, zero, progress).terms["lambertian_bias"] for progress in times]
    np.testing.assert_allclose(waited, [0, 0, 0.5, 1, 1], atol=1e-6)  # of float32


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


@pytest.fixture(scope="module")
def programs(ball_scene: tuple[Scene, Path]) -> tuple[Step, TrainState, Pixels, Programs]:
    """A small step with a table that no other array is as large as, compiled."""
    config = Config.model_validate(models.merged(small("surfnerf_voxels").model_dump(), {"encoding": {"log2_size": 12}}))
    one_step = Step.of(config, SceneFacts(Normalisation.of(ball_scene[0])))
    views = ball_scene[0].split("train")
    with progress("reading", len(views)) as shown:
        pixels = Pixels.load(views, Normalisation.of(ball_scene[0]), 1.0, shown)
    state = one_step.initial(jax.random.key(0), None, len(views))
    return one_step, state, pixels, one_step.compiled(state, pixels)


def test_no_program_copies_a_table(programs: tuple[Step, TrainState, Pixels, Programs]) -> None:
    """Zeros into which a gradient is scattered are made by copying zeros; nothing else as large as a table is copied."""
    _, state, _, compiled = programs
    sizes = {leaf.size for leaf in (state.model.field.encoding.table, state.model.sampler.grid.density)}
    copied = []
    for stage in compiled.stages:
        for match in re.finditer(r"= \w+\[([\d,]+)\]\S* copy(?:-start)?\(%?([\w.\-]+)\)", stage.as_text()):
            if math.prod(map(int, match[1].split(","))) in sizes:
                copied.append(match[0])
    assert [line for line in copied if "broadcast" not in line] == []
    descend = compiled.descend.memory_analysis()
    assert descend.alias_size_in_bytes > 0.9 * descend.output_size_in_bytes, "state is overwritten"
    assert descend.temp_size_in_bytes < 2 * state.model.field.encoding.table.nbytes, "no second table beside the squares of one"
    for stage in compiled.stages:
        assert not re.search(r" conditional\(", stage.as_text()), "nothing passes through a branch"


def test_programs_do_what_one_function_does(programs: tuple[Step, TrainState, Pixels, Programs]) -> None:
    one_step, state, pixels, compiled = programs
    seed, progress = jnp.asarray(3, jnp.int32), jnp.asarray(0.5, jnp.float32)
    expected = state
    one = jax.jit(one_step).lower(state, pixels, seed, progress, jnp.asarray(True))
    one = one.compile(compiler_options={"xla_backend_optimization_level": 0})
    for i in range(3):
        expected, terms = one(expected, pixels, seed, progress, jnp.asarray(i == 2))
    found, same = compiled(jax.tree.map(jnp.copy, state), pixels, seed, progress, 3, True)
    assert terms.keys() == same.keys() and int(found.step) == 3
    for name in terms:
        np.testing.assert_allclose(same[name], terms[name], rtol=1e-4, atol=1e-7, err_msg=name)
    for one, other in zip(jax.tree.leaves(found.model), jax.tree.leaves(expected.model), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-3)
    _, plain = compiled(found, pixels, seed, progress, 1, False)
    assert plain.keys() == same.keys() and not plain["normal_consistency"], "a second pass that is left out costs nothing"


def test_devices_that_do_not_divide_a_batch_are_left_out() -> None:
    config = small("surfnerf_voxels")  # 64 rays, 512 samples
    sizes = Step.of(config, FACTS).initial(jax.random.key(0)).model.sampler.divided_sizes
    alone = Division.among([jax.devices()[0]] * 1, sizes)
    assert alone.mesh is None and alone.everywhere is None
    assert Division.among([jax.devices()[0]] * 3, sizes).mesh is None
