"""What fields rely on, whichever encoding they have."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reconstruct.config import EncodingConfig
from reconstruct.field.encodings.create import create_encoding
from reconstruct.field.encodings.encoding import Encoding, blurred

KINDS = ("lattice", "voxels", "frequencies")


@pytest.fixture(params=KINDS)
def encoding(request: pytest.FixtureRequest) -> Encoding:
    config = EncodingConfig(kind=request.param, levels=3, features=2, log2_size=8, coarsest=2, finest=8)
    return create_encoding(jax.random.key(0), config)


def test_it_keeps_the_protocol(encoding: Encoding) -> None:
    assert isinstance(encoding, Encoding)
    points = jax.random.uniform(jax.random.key(1), (3, 7), minval=-1)
    for scale in (None, jnp.full(7, 0.01), jnp.full((3, 7), 0.01)):
        value, jacobian = encoding.value_and_jacobian(points, scale)
        np.testing.assert_allclose(encoding(points, scale), value, atol=1e-6)
        assert value.shape == (encoding.num_channels, 7) and jacobian.shape == (encoding.num_channels, 3, 7)
    assert encoding.decay().shape == ()


def test_a_wide_gaussian_makes_everything_fade(encoding: Encoding) -> None:
    points = jax.random.uniform(jax.random.key(1), (3, 50), minval=-1)
    sharp, soft = (np.abs(encoding(points, jnp.full(50, sigma))) for sigma in (1e-4, 10.0))
    assert soft.mean() < 0.05 * sharp.mean()


def test_no_gradient_goes_to_the_blur(encoding: Encoding) -> None:
    points = jax.random.uniform(jax.random.key(1), (3, 50), minval=-1)
    wide = eqx.tree_at(lambda e: e.blur, encoding, jnp.asarray(0.1))
    gradient = jax.grad(lambda blur: jnp.sum(eqx.tree_at(lambda e: e.blur, wide, blur)(points)))(wide.blur)
    assert gradient == 0


def test_widths_add_as_variances() -> None:
    np.testing.assert_allclose(blurred(jnp.asarray(3.0), jnp.array([4.0, 0.0])), [5, 3])
    np.testing.assert_allclose(blurred(jnp.asarray(0.0), jnp.array([[3.0], [0.0], [0.0]])), np.sqrt([3]), rtol=1e-6)
    np.testing.assert_allclose(blurred(jnp.asarray(2.0), None), [2])
