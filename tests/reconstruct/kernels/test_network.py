"""Small networks by compiled loops against plain JAX, and against float64."""

import functools
from typing import Any

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from koala3d.reconstruct.field.mlp import Mlp
from koala3d.reconstruct.kernels import network
from koala3d.reconstruct.numerics.compiling import jit
from tests import drawn

pytestmark = pytest.mark.usefixtures("kernels_run")


MOST = 8192
"""Points that the twin computes at once: it is compiled for no other number, and fewer of them are the first of these."""


def network_of(channels: int, depth: int, outputs: int, width: int = 64) -> Mlp:
    """With biases that are not zero."""
    return drawn.filled(lambda: Mlp.create(jax.random.key(0), channels=channels, width=width, depth=depth, outputs=outputs))


def both_ways(made: Mlp, inputs: jax.Array, bars: Any, sensitivity: bool) -> Any:
    """Results, and gradients of cotangents to inputs, weights and biases."""
    found, pull = jax.vjp(Mlp.with_sensitivity if sensitivity else Mlp.__call__, made, inputs)
    return found, pull(bars)


native_of = jit(lambda *arguments: both_ways(*arguments), static_argnums=3)


@functools.partial(jit, static_argnums=3)
def twin_of(*arguments: Any) -> Any:
    """The same in plain JAX."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(network, "takes", lambda *_: False)
        return both_ways(*arguments)


def assert_alike(made: Mlp, inputs: jax.Array, *, sensitivity: bool, count: int | None = None) -> None:
    """For the first points, if there is a `count`: nothing comes back to the twin from the others."""
    most = inputs.shape[1]
    count = most if count is None else count
    bars = drawn.normal(len(made.biases[-1]), most, seed=9), drawn.normal(inputs.shape[0], most, seed=8)
    bars = bars if sensitivity else bars[0]
    cut = lambda tree: jax.tree.map(lambda one: np.asarray(one)[:, :count], tree)  # noqa: E731
    ours = native_of(made, cut(inputs), cut(bars), sensitivity)
    found, (of_network, of_inputs) = twin_of(
        made, inputs, jax.tree.map(lambda bar: np.where(np.arange(most) < count, bar, 0.0), bars), sensitivity
    )
    theirs = cut(found), (of_network, cut(of_inputs))
    for one, other in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        assert one.shape == other.shape  # sums of float32 in another order: 1e-5 of the largest
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5 * float(np.max(np.abs(other))) + 1e-30)


@pytest.mark.parametrize("sensitivity", [False, True])
@pytest.mark.parametrize("count", [256, 257, 511, 512, 513, MOST])
def test_values_and_gradients_are_those_of_the_twin(count: int, sensitivity: bool) -> None:
    assert_alike(network_of(16, 1, 11), drawn.normal(16, MOST), sensitivity=sensitivity, count=count)


@pytest.mark.parametrize("depth", [2, 3])
def test_several_hidden_layers(depth: int) -> None:
    assert_alike(network_of(39, depth, 3), drawn.normal(39, 1000), sensitivity=False)


@pytest.mark.slow
@pytest.mark.parametrize("count", [2**17, 2**20])
def test_large_batches(count: int) -> None:
    assert_alike(network_of(16, 1, 11), drawn.normal(16, count), sensitivity=True)


@pytest.mark.parametrize(
    ("channels", "width", "outputs", "sensitivity"),
    [(1, 1, 1, True), (3, 4, 5, True), (15, 17, 16, False), (17, 70, 33, True), (35, 2, 1, False)],
)
def test_any_size(channels: int, width: int, outputs: int, sensitivity: bool) -> None:
    assert_alike(network_of(channels, 1, outputs, width), drawn.normal(channels, 300), sensitivity=sensitivity)


NUMBERS = st.sampled_from([0.0, -0.0, 1e-38, 1e-20, 1.0, -3.0, 1e10])


@given(inputs=st.lists(NUMBERS, min_size=1, max_size=40))
def test_worst_cases(inputs: list[float]) -> None:
    assert_alike(network_of(5, 1, 3, 9), drawn.array(np.resize(inputs, (5, 300))), sensitivity=True)


def test_few_points_are_left_to_the_twin() -> None:
    made = network_of(4, 1, 2)
    inputs = drawn.normal(4, network.WORTH_IT)
    assert network.takes(made._layers, inputs)
    assert not network.takes(made._layers, jax.ShapeDtypeStruct((4, network.WORTH_IT - 1), np.float32))


def test_sensitivity_against_double_precision() -> None:
    made, inputs = network_of(16, 1, 11), drawn.normal(16, 512)
    bars = drawn.normal(11, 512), drawn.normal(16, 512)
    (_, found), _ = native_of(made, inputs, bars, True)
    first, second, x = (np.asarray(a, np.float64) for a in (made.weights[0], made.weights[1], inputs))
    hidden = first @ x + np.asarray(made.biases[0], np.float64)[:, None]
    expected = first.T @ (second[0][:, None] * (hidden > 0))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)  # 64 products, each rounded at 6e-8
