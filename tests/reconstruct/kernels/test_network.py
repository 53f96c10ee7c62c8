"""Small networks by compiled loops against plain JAX, and against float64."""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reconstruct.field.mlp import Mlp
from reconstruct.kernels import network
from reconstruct.numerics.compiling import jit

pytestmark = pytest.mark.usefixtures("kernels_run")


def network_of(channels: int, depth: int, outputs: int, width: int = 64) -> Mlp:
    """With biases that are not zero."""
    made = Mlp.create(jax.random.key(0), channels=channels, width=width, depth=depth, outputs=outputs)
    biases = tuple(0.1 * jax.random.normal(jax.random.key(5), bias.shape) for bias in made.biases)
    return eqx.tree_at(lambda one: one.biases, made, biases)


def both_ways(made: Mlp, inputs: jax.Array, sensitivity: bool) -> Any:
    """Results, and gradients of random cotangents to inputs, weights and biases."""
    found, pull = jax.vjp(Mlp.with_sensitivity if sensitivity else Mlp.__call__, made, inputs)
    return found, pull(jax.tree.map(lambda one: jax.random.normal(jax.random.key(9), one.shape), found))


native_of = jit(lambda *arguments: both_ways(*arguments), static_argnums=2)


@functools.partial(jit, static_argnums=2)
def twin_of(*arguments: Any) -> Any:
    """The same in plain JAX."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(network, "takes", lambda *_: False)
        return both_ways(*arguments)


def assert_alike(made: Mlp, inputs: jax.Array, *, sensitivity: bool) -> None:
    ours, theirs = (jax.tree.leaves(run(made, inputs, sensitivity)) for run in (native_of, twin_of))
    for one, other in zip(ours, theirs, strict=True):  # sums of float32 in another order: 1e-5 of the largest
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5 * float(jnp.max(jnp.abs(other))) + 1e-30)


@pytest.mark.parametrize("sensitivity", [False, True])
@pytest.mark.parametrize("count", [256, 257, 511, 512, 513, 8192])
def test_values_and_gradients_are_those_of_the_twin(count: int, sensitivity: bool) -> None:
    assert_alike(network_of(16, 1, 11), jax.random.normal(jax.random.key(1), (16, count)), sensitivity=sensitivity)


@pytest.mark.parametrize("depth", [2, 3])
def test_several_hidden_layers(depth: int) -> None:
    assert_alike(network_of(39, depth, 3), jax.random.normal(jax.random.key(1), (39, 1000)), sensitivity=False)


@pytest.mark.parametrize("count", [2**17, pytest.param(2**20, marks=pytest.mark.slow)])
def test_large_batches(count: int) -> None:
    assert_alike(network_of(16, 1, 11), jax.random.normal(jax.random.key(1), (16, count)), sensitivity=True)


@pytest.mark.parametrize(
    ("channels", "width", "outputs", "sensitivity"),
    [(1, 1, 1, True), (3, 4, 5, True), (15, 17, 16, False), (17, 70, 33, True), (35, 2, 1, False)],
)
def test_any_size(channels: int, width: int, outputs: int, sensitivity: bool) -> None:
    inputs = jax.random.normal(jax.random.key(1), (channels, 300))
    assert_alike(network_of(channels, 1, outputs, width), inputs, sensitivity=sensitivity)


NUMBERS = st.sampled_from([0.0, -0.0, 1e-38, 1e-20, 1.0, -3.0, 1e10])


@given(inputs=st.lists(NUMBERS, min_size=1, max_size=40))
def test_worst_cases(inputs: list[float]) -> None:
    assert_alike(network_of(5, 1, 3, 9), jnp.asarray(np.resize(inputs, (5, 300)), jnp.float32), sensitivity=True)


def test_few_points_are_left_to_the_twin() -> None:
    made = network_of(4, 1, 2)
    assert not network.takes(made._layers, jnp.zeros((4, network.WORTH_IT - 1)))
    assert network.takes(made._layers, jnp.zeros((4, network.WORTH_IT)))


def test_sensitivity_against_double_precision() -> None:
    made, inputs = network_of(16, 1, 11), jax.random.normal(jax.random.key(1), (16, 400))
    found = made.with_sensitivity(inputs)[1]
    first, second, x = (np.asarray(a, np.float64) for a in (made.weights[0], made.weights[1], inputs))
    hidden = first @ x + np.asarray(made.biases[0], np.float64)[:, None]
    expected = first.T @ (second[0][:, None] * (hidden > 0))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)  # 64 products, each rounded at 6e-8
