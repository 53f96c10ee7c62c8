"""The step: when a bias begins, several devices, memory. That models train is in test_every_model."""

import json
import math
import os
import re
import subprocess
import sys
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct import models
from koala3d.reconstruct.kernels import native
from koala3d.reconstruct.numerics.compiling import jit
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.surface.second_pass import SecondPass
from koala3d.reconstruct.training.batches import Division
from koala3d.reconstruct.training.faults import FAULTS
from koala3d.reconstruct.training.step import Part, Step
from tests.small import SIZES, Trainable, small

FACTS = SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.5, 4.0))


def test_the_bias_at_an_object_waits_until_two_fifths_of_the_training(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SecondPass, "terms", lambda _, field, rays, surfaces, key, bias: {"lambertian_bias": bias})
    step = Step.of(models.of_kinds(small("surfnerf"), ["surroundings"]), FACTS)
    model = step.initial(jax.random.key(0)).model
    part = Part(jax.tree.map(jnp.zeros_like, model.split()[0]), {"mse": jnp.zeros(())}, None, None, None)
    zero, times = jnp.asarray(0), jnp.array([0.0, 0.4, 0.45, 0.5, 1.0])
    waited = [step.regularised(model, zero, part, zero, progress).terms["lambertian_bias"] for progress in times]
    np.testing.assert_allclose(waited, [0, 0, 0.5, 1, 1], atol=1e-6)  # of float32


SHARDED = """
import jax, jax.numpy as jnp, numpy as np
from koala3d.reconstruct import models
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.models import load_config, merged
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from koala3d.reconstruct.training.batches import Division
from koala3d.reconstruct.training.step import Step
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
config = Config.model_validate(merged(load_config(sys.argv[2]).model_dump(), json.loads(sys.argv[1])))
normalisation = Normalisation((0.0, 0.0, 0.0), 1.0, sys.argv[3] == "bounded", 0.5, 6.0)
facts = SceneFacts(normalisation, half_box=(0.5, 0.5, 0.5), box_is_stated=True)
found = []
for count in (1, 4):
    state = Step.of(config, facts).initial(jax.random.key(0))
    division = Division.among(jax.devices()[:count], state.model.sampler.divided_sizes)
    assert (division.mesh is None) == (count == 1) and (count == 1 or division.mesh.size == 4)
    if division.everywhere is not None:
        state, pixels = jax.device_put((state, pixels), division.everywhere)
    arguments = (jnp.asarray(0, jnp.int32), jnp.asarray(0.5, jnp.float32), 1, True, jnp.asarray(True))
    step = replace(Step.of(config, facts), division=division).compiled(state, pixels, xla_backend_optimization_level=0)
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


@pytest.mark.parametrize(
    ("model", "world"),
    [
        ("zipnerf", "among surroundings"),
        pytest.param("surfnerf", "among surroundings", marks=pytest.mark.slow),
        pytest.param("surfnerf", "bounded", marks=pytest.mark.slow),
    ],
)
def test_four_devices_come_to_the_result_of_one(model: str, world: str) -> None:
    """Three steps: sums over rays in another order, which Adam's normalisation makes larger: hence a thousandth, not 1e-6."""
    environment = {**os.environ, "XLA_FLAGS": "--xla_force_host_platform_device_count=4", "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(
        [sys.executable, "-c", SHARDED, json.dumps(SIZES), model, world], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-3000:]


def test_no_program_copies_a_table(trainable: Trainable) -> None:
    """Zeros into which a gradient is scattered are made by copying zeros; nothing else as large as a table is copied."""
    model, programs = trainable.start.model, trainable.programs
    sizes = {leaf.size for leaf in (model.field.encoding.table, model.sampler.grid.density)}
    copied = []
    for stage in programs.stages:
        for match in re.finditer(r"= \w+\[([\d,]+)\]\S* copy(?:-start)?\(%?([\w.\-]+)\)", stage.as_text()):
            if math.prod(map(int, match[1].split(","))) in sizes:
                copied.append(match[0])
    assert [line for line in copied if "broadcast" not in line] == []
    descend = programs.descend.memory_analysis()
    assert descend.alias_size_in_bytes > 0.9 * descend.output_size_in_bytes, "state is overwritten"
    assert descend.temp_size_in_bytes < 2 * model.field.encoding.table.nbytes, "no second table beside the squares of one"
    for stage in programs.stages:
        for result in re.findall(r"= (.*?) conditional\(", stage.as_text()):
            shapes = re.findall(r"\[([\d,]+)\]", result)
            assert shapes, "what a branch results in is read"
            assert all(math.prod(map(int, shape.split(","))) < min(sizes) for shape in shapes), "no table passes through a branch"
    assert not any(" conditional(" in stage.as_text() for stage in programs.stages[1:]), "only a batch asks whether to look"


def test_a_second_pass_that_is_left_out_costs_nothing(trainable: Trainable) -> None:
    opaque = lambda state: state.model.field.spatial.biases[-1]  # noqa: E731
    start = eqx.tree_at(opaque, trainable.start, opaque(trainable.start).at[0].set(5.0))
    _, (plain, second) = trainable.trained(2, start, second=lambda index: index == 1)
    assert plain.keys() == second.keys() and plain["normal_consistency"] == 0 < second["normal_consistency"]


def test_a_gradient_that_is_added_to_is_a_sum(trainable: Trainable, monkeypatch: pytest.MonkeyPatch) -> None:
    """Losses at surfaces, and the second pass: the same with gradients of their own that are added up."""

    def apart(loss, model, gradient):
        learned, held = model.split()
        more, terms = jax.grad(lambda learned: loss(eqx.combine(learned, held).field), has_aux=True)(learned)
        return jax.tree.map(jnp.add, gradient, more), terms

    step, pixels = trainable.step, trainable.pixels
    opaque = lambda state: state.model.field.spatial.biases[-1]  # noqa: E731
    state = eqx.tree_at(opaque, trainable.start, opaque(trainable.start).at[0].set(5.0))
    number, progress = jnp.asarray(0, jnp.int32), jnp.asarray(0.7, jnp.float32)

    def gradients(model):
        part = step.begun(model, number, pixels, number, progress, jnp.asarray(True))
        return part.gradient, step.regularised(model, number, part, number, progress).gradient

    added = jit(gradients)(state.model)
    monkeypatch.setattr("koala3d.reconstruct.training.step._added", apart)
    summed = jit(lambda model: gradients(model))(state.model)
    assert not np.allclose(added[0].field.encoding.table, added[1].field.encoding.table, rtol=1e-3), "the second pass adds"
    for one, other in zip(jax.tree.leaves(added), jax.tree.leaves(summed), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5 * float(np.abs(other).max()))  # sums of float32 in another order


def test_faults_of_steps_in_a_chunk_are_kept(trainable: Trainable) -> None:
    earlier = replace(trainable, programs=replace(trainable.programs, none=jnp.asarray(4, jnp.int32)))
    assert earlier.trained(1)[1][0][FAULTS] == 4, "beside those of the step itself, of which there are none"


def test_a_step_uses_each_compiled_kernel(trainable: Trainable, kernels_run: None) -> None:
    """A kernel that always falls back is not found out by results, which are its twin's."""
    text = "".join(stage.as_text() for stage in trainable.programs.stages)
    wanted = {name for names in native.KERNELS.values() for name in names} - {"probe"}
    assert {name for name in wanted if f'"koala_{name}_' not in text} == set()


def test_devices_that_do_not_divide_a_batch_are_left_out() -> None:
    config = small("surfnerf_voxels")  # 64 rays, 512 samples
    sizes = Step.of(config, FACTS).initial(jax.random.key(0)).model.sampler.divided_sizes
    alone = Division.among([jax.devices()[0]] * 1, sizes)
    assert alone.mesh is None and alone.everywhere is None
    assert Division.among([jax.devices()[0]] * 3, sizes).mesh is None
