"""What fields rely on, whichever encoding they have."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.config import EncodingConfig
from koala3d.reconstruct.field.encodings.create import create_encoding
from koala3d.reconstruct.field.encodings.encoding import Encoding, blurred
from tests import drawn

KINDS = ("lattice", "voxels", "frequencies")
COUNT = 50
POINTS = np.float32(np.random.default_rng(1).uniform(-1, 1, (3, COUNT)))


@jax.jit
def looked_at(encoding: Encoding, points: jax.Array, sigma: jax.Array) -> list[tuple[jax.Array, jax.Array, jax.Array]]:
    """Features, and features with slopes, of points of no extent, of one extent, and of one for each axis."""
    scales = (None, sigma, jnp.stack([sigma] * 3))
    return [(encoding(points, scale), *encoding.value_and_jacobian(points, scale)) for scale in scales]


@pytest.fixture(scope="module", params=KINDS)
def encoding(request: pytest.FixtureRequest) -> Encoding:
    config = EncodingConfig(kind=request.param, levels=3, features=2, log2_size=8, coarsest=2, finest=8)
    return drawn.filled(lambda: create_encoding(jax.random.key(0), config))


def test_it_keeps_the_protocol(encoding: Encoding) -> None:
    assert isinstance(encoding, Encoding)
    for alone, value, jacobian in looked_at(encoding, POINTS, np.full(COUNT, 0.01, np.float32)):
        np.testing.assert_allclose(alone, value, atol=1e-6)
        assert value.shape == (encoding.num_channels, COUNT) and jacobian.shape == (encoding.num_channels, 3, COUNT)
    assert encoding.decay >= 0


def test_a_wide_gaussian_makes_everything_fade(encoding: Encoding) -> None:
    sharp, soft = (np.abs(looked_at(encoding, POINTS, np.full(COUNT, sigma, np.float32))[1][0]).mean() for sigma in (1e-4, 10.0))
    assert soft < 0.05 * sharp


def test_no_gradient_goes_to_the_blur(encoding: Encoding) -> None:
    total = lambda blur, points: jnp.sum(eqx.tree_at(lambda e: e.blur, encoding, blur)(points))  # noqa: E731
    assert jax.jit(jax.grad(total))(np.float32(0.1), POINTS) == 0


def test_widths_add_as_variances() -> None:
    both = jax.jit(blurred)
    np.testing.assert_allclose(both(np.float32(3.0), np.float32([4.0, 0.0])), [5, 3])
    np.testing.assert_allclose(both(np.float32(0.0), np.float32([[3.0], [0.0], [0.0]])), np.sqrt([3]), rtol=1e-6)
    np.testing.assert_allclose(both(np.float32(2.0), None), [2])
