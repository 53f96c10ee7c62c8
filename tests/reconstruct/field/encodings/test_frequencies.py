import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.field.encodings.frequencies import Frequencies
from tests import drawn

EVALUATE = jax.jit(lambda encoding, points, scale=None: encoding.value_and_jacobian(points, scale))


@pytest.fixture(scope="module")
def encoding() -> Frequencies:
    return Frequencies.create(levels=5, coarsest=1.0, finest=16.0)


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    return np.random.default_rng(0).uniform(-2, 2, (3, 60)).astype(np.float32)


def reference(points: np.ndarray, scale: np.ndarray, nodes: int = 81) -> np.ndarray:
    """(channels, n) expected sines and cosines by Gauss-Hermite quadrature of the normal distribution, float64."""
    x, weight = np.polynomial.hermite_e.hermegauss(nodes)
    weight = weight / weight.sum()
    values = points[..., None].astype(np.float64) + scale[..., None] * x
    sines, cosines = ([wave(f * values) @ weight for f in (1, 2, 4, 8, 16)] for wave in (np.sin, np.cos))
    return np.concatenate([*sines, *cosines])


@pytest.mark.parametrize("sigma", [0.0, 0.01, 0.1, 0.5])
def test_features_are_expectations_under_a_gaussian(encoding: Frequencies, points: np.ndarray, sigma: float) -> None:
    """Axes of different widths; 16 * 0.5 = 8 standard deviations of phase are within the quadrature's reach."""
    scale = np.stack([np.full(60, sigma), np.full(60, sigma / 2), np.zeros(60)])
    expected = reference(points, scale)
    np.testing.assert_allclose(EVALUATE(encoding, points, np.float32(scale))[0], expected, atol=1e-5)
    if sigma == 0:
        np.testing.assert_allclose(EVALUATE(encoding, points)[0], expected, atol=1e-5)


def test_one_scale_for_all_axes_and_the_blur(encoding: Frequencies, points: np.ndarray) -> None:
    """0.3 and 0.4 together are 0.5, and one scale is the same on every axis."""
    blurred = Frequencies(drawn.array(0.3), encoding.frequencies)
    expected = reference(points, np.full((3, 60), 0.5))
    np.testing.assert_allclose(EVALUATE(blurred, points, np.full(60, 0.4, np.float32))[0], expected, atol=1e-5)


@pytest.mark.parametrize("sigma", [0.0, 0.1])
def test_jacobian_equals_differences(encoding: Frequencies, points: np.ndarray, sigma: float) -> None:
    """Central differences of the float64 reference; their own error is (16 step)^2 / 6 of slopes up to 16."""
    step, scale = 1e-4, np.full((3, 60), sigma)
    jacobian = np.asarray(EVALUATE(encoding, points, np.float32(scale))[1])
    for axis in range(3):
        offset = step * np.eye(3)[axis][:, None]
        difference = (reference(points + offset, scale) - reference(points - offset, scale)) / (2 * step)
        np.testing.assert_allclose(jacobian[:, axis], difference, atol=2e-4)


def test_published_frequencies_and_great_ones_stay_finite(points: np.ndarray) -> None:
    """1, 2, ... 2^15: powers of two multiply exactly, so that the sine of the float32 position itself comes out."""
    published = Frequencies.create(levels=16, coarsest=1.0, finest=2.0**15)
    np.testing.assert_allclose(published.frequencies, 2.0 ** np.arange(16))
    assert published.num_channels == 96
    values = np.asarray(EVALUATE(published, points)[0])
    np.testing.assert_allclose(values[45:48], np.sin(2.0**15 * points.astype(np.float64)), atol=1e-5)
    wide, jacobian = EVALUATE(published, points, np.full(60, 1e3, np.float32))
    np.testing.assert_array_equal(wide, 0)
    assert np.isfinite(jacobian).all()


def test_nothing_is_learned(encoding: Frequencies, points: np.ndarray) -> None:
    gradient = jax.jit(jax.grad(lambda e, p: jnp.sum(e(p))))(encoding, points)
    np.testing.assert_array_equal(jax.tree.leaves(gradient)[0], 0)
    assert encoding.decay == 0
