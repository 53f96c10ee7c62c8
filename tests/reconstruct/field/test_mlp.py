import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.field.mlp import Mlp, computed_in, rounded_product
from tests import drawn

CALL = jax.jit(lambda network, inputs: network(inputs))


@pytest.mark.parametrize(("depth", "skip"), [(1, 0), (3, 0), (3, 2), (4, 2)])
def test_it_equals_layers_written_out(depth: int, skip: int) -> None:
    network = drawn.filled(lambda: Mlp.create(jax.random.key(0), channels=5, width=16, depth=depth, outputs=3, skip=skip))
    inputs = np.random.default_rng(0).normal(size=(5, 7))
    hidden = inputs
    for layer, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        if skip and layer == skip:
            hidden = np.concatenate([hidden, inputs])
        hidden = np.asarray(weight, np.float64) @ hidden + np.asarray(bias)[:, None]
        hidden = np.maximum(hidden, 0) if layer < depth else hidden
    np.testing.assert_allclose(CALL(network, np.float32(inputs)), hidden, atol=1e-5)
    assert len(network.weights) == depth + 1


def test_fresh_weights_keep_the_signal_s_size() -> None:
    """He's rule: the mean square of pre-activations stays that of the input through layers of 256, within a factor 2."""
    network = Mlp.create(jax.random.key(1), channels=256, width=256, depth=4, outputs=256)
    outputs = np.asarray(CALL(network, drawn.normal(256, 200)))
    # He's factor 2 makes up for the ReLU, so that the first layer doubles and the last, without one, halves nothing
    assert 0.5 < np.mean(outputs**2) < 2


HALF_ULP = 2.0**-8
"""Relative error of a number that is rounded to 8 significant bits."""


def rounded(values: np.ndarray) -> np.ndarray:
    """In float64, what bfloat16 keeps of float32 numbers: 8 significant bits, ties to even."""
    mantissa, exponent = np.frexp(np.asarray(values, np.float64))
    return np.ldexp(np.round(mantissa * 256) / 256, exponent)


def test_products_of_rounded_factors_and_their_derivatives() -> None:
    """Exact products of 8-bit factors, summed in float32: 1e-6 of the sum of their sizes. In derivatives, too."""
    left, right, weight = (np.float32(np.random.default_rng(i).normal(size=s)) for i, s in enumerate([(5, 40), (40, 7), (5, 7)]))
    product = jax.jit(rounded_product)(left, right)
    np.testing.assert_allclose(product, rounded(left) @ rounded(right), atol=1e-6 * 40)
    assert np.abs(np.asarray(product) - np.float64(left) @ right).max() > 1e-3, "rounding makes a difference"
    loss = lambda a, b: jnp.sum(weight * rounded_product(a, b))  # noqa: E731
    for found, expected in zip(
        jax.jit(jax.grad(loss, (0, 1)))(left, right),
        (rounded(weight) @ rounded(right).T, rounded(left).T @ rounded(weight)),
        strict=True,
    ):
        np.testing.assert_allclose(found, expected, atol=1e-6 * 40)
    along = lambda a: jax.vjp(lambda b: rounded_product(a, b), jnp.asarray(right))[1](jnp.asarray(weight))[0]  # noqa: E731
    again = jax.jit(jax.grad(lambda a: jnp.sum(along(a) * right)))(left)
    np.testing.assert_allclose(again, rounded(weight) @ rounded(right).T, atol=1e-6 * 40)


def test_mixed_precision_errs_no_more_than_its_rounding_explains() -> None:
    """Each layer multiplies the error that comes in and adds two roundings per product; ReLU adds nothing.

    The bound is the worst case of every sum; what is measured is far below it, and not zero.
    """
    network = drawn.filled(lambda: Mlp.create(jax.random.key(0), channels=20, width=64, depth=3, outputs=10, skip=2))
    inputs = drawn.normal(20, 50)
    mixed = computed_in("bfloat16", network)
    assert all(one is other for one, other in zip(jax.tree.leaves(network), jax.tree.leaves(mixed), strict=True))
    twice = 2 * HALF_ULP + HALF_ULP**2
    hidden, error = np.asarray(inputs, np.float64), np.zeros(inputs.shape)
    first = hidden
    for layer, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        if layer == network.skip:
            hidden, error = np.concatenate([hidden, first]), np.concatenate([error, 0 * first])
        size = np.abs(np.asarray(weight, np.float64))
        error = size @ (error * (1 + twice) + twice * np.abs(hidden))
        hidden = np.asarray(weight, np.float64) @ hidden + np.asarray(bias)[:, None]
        hidden = np.maximum(hidden, 0) if layer < 3 else hidden
    apart = np.abs(np.asarray(CALL(mixed, inputs), np.float64) - hidden)
    assert (apart <= error).all() and 0.001 < apart.max() < 0.1 * error.max()


def test_networks_of_a_tree_are_computed_in_the_wanted_precision() -> None:
    network = drawn.filled(lambda: Mlp.create(jax.random.key(0), channels=2, width=4, depth=1, outputs=1))
    tree = {"one": network, "two": (network, drawn.array(np.ones(3))), "none": None}
    mixed = computed_in("bfloat16", tree)
    assert mixed["one"].precision == mixed["two"][0].precision == "bfloat16" and mixed["two"][1] is tree["two"][1]
    back = computed_in("float32", mixed)["one"]
    assert all(one is other for one, other in zip(jax.tree.leaves(back), jax.tree.leaves(network), strict=True))
    assert jax.tree.structure(back) == jax.tree.structure(network), "and back"
