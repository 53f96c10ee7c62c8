import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import sph_harm_y

from koala3d.reconstruct.field.encodings.directional import ide_channels, integrated_directional_encoding

DEGREE, COUNT = 5, 300
ENCODE = jax.jit(integrated_directional_encoding, static_argnums=2)


def encoded_in_float32(directions: np.ndarray, roughness: np.ndarray | float, degree: int = DEGREE) -> np.ndarray:
    """By a program for COUNT directions, whatever their number."""
    count = directions.shape[1]
    assert COUNT % count == 0
    given = np.float32(np.tile(directions, COUNT // count)), np.float32(np.resize(roughness, COUNT))
    encoded = ENCODE(*given, degree)
    assert encoded.dtype == np.float32 and encoded.shape == (ide_channels(degree), COUNT)
    return np.asarray(encoded)[:, :count]


def sphere(count: int = COUNT, seed: int = 0) -> np.ndarray:
    """(3, count) unit vectors, poles and equator included, exact to float32."""
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    vectors[:6] = [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, 1, 0], [1e-4, 0, 1], [0, -1e-4, -1]]
    return (vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)).T


def harmonics(directions: np.ndarray, degree: int = DEGREE) -> np.ndarray:
    """(channels, n) of scipy's spherical harmonics in the encoding's order, float64."""
    x, y, z = directions
    polar, azimuth = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    outputs = []
    for l in (2**i for i in range(degree)):  # noqa: E741
        for m in range(l + 1):
            value = sph_harm_y(l, m, polar, azimuth)
            outputs += [value.real, value.imag]
    return np.stack(outputs)


def orders(degree: int = DEGREE) -> np.ndarray:
    """l of every channel."""
    return np.concatenate([[2**i] * (2 * (2**i + 1)) for i in range(degree)])


def moments(kappa: float, nodes: int = 400) -> np.ndarray:
    """E[P_l(cos angle)] under a von Mises-Fisher lobe, l = 1, 2, ... 16, by Gauss-Legendre quadrature in the cosine."""
    w, weight = np.polynomial.legendre.leggauss(nodes)
    # the lobe lives within a few 1/kappa of the mean direction: nodes go where it is
    w = 1 - (1 - w) / 2 * min(2.0, 60 / kappa)
    density = np.exp(kappa * (w - 1)) * weight
    density /= density.sum()
    return np.array([np.sum(density * np.polynomial.legendre.Legendre.basis(2**i)(w)) for i in range(DEGREE)])


@pytest.mark.parametrize("degree", [1, DEGREE, *(pytest.param(n, marks=pytest.mark.slow) for n in (3, 6))])
def test_without_roughness_it_is_the_spherical_harmonics(degree: int) -> None:
    """float32 up to l = 16 (and 32): the recurrence loses a digit or two at most, where powers of z lose them all."""
    directions = sphere()
    encoded = encoded_in_float32(directions, 0.0, degree)
    np.testing.assert_allclose(encoded, harmonics(directions, degree), atol=1e-5 if degree <= DEGREE else 5e-5)


def test_attenuation_is_the_published_formula() -> None:
    directions, roughness = sphere(), np.random.default_rng(1).uniform(0, 2, COUNT)
    encoded = encoded_in_float32(directions, roughness)
    expected = harmonics(directions) * np.exp(-orders()[:, None] * (orders()[:, None] + 1) / 2 * roughness)
    np.testing.assert_allclose(encoded, expected, atol=1e-5)


@pytest.mark.parametrize("roughness", [1e-3, 1e-2, 0.05])
def test_it_is_close_to_the_mean_over_a_lobe(roughness: float) -> None:
    """Funk-Hecke: the mean of Y_lm over a lobe is its value times the lobe's l-th moment.

    The attenuation is that moment to first order in the roughness r: its error is at most 0.6 l (l + 1) r^2
    (measured: largest 0.5), hence within 4% of the harmonic for l^2 r < 0.5.
    """
    true = moments(1 / roughness)
    l = 2 ** np.arange(DEGREE)  # noqa: E741
    approximation = np.exp(-l * (l + 1) * roughness / 2)
    assert (np.abs(true - approximation) <= 0.6 * l * (l + 1) * roughness**2).all()
    directions = sphere(60, seed=2)
    encoded = encoded_in_float32(directions, roughness)
    expected = harmonics(directions) * true[np.log2(orders()).astype(int), None]
    allowed = 0.6 * orders() * (orders() + 1) * roughness**2
    assert (np.abs(encoded - expected) <= allowed[:, None] + 1e-5).all()


def test_the_lobe_by_brute_force() -> None:
    """Mean of scipy's harmonics over a lobe sampled on a fine grid around one direction, without Funk-Hecke."""
    roughness, mean = 0.01, np.array([0.48, -0.6, 0.64])
    share, turn = np.meshgrid((np.arange(600) + 0.5) / 600, (np.arange(64) + 0.5) / 64 * 2 * np.pi, indexing="ij")
    w = 1 + roughness * np.log(share)  # inverse of the lobe's distribution in the cosine; its tail beyond w = -1 is e^-200
    across = np.cross(mean, [0.0, 0, 1]) / np.linalg.norm(np.cross(mean, [0.0, 0, 1]))
    up, side = np.cross(across, mean), np.sqrt(np.maximum(1 - w**2, 0))
    samples = (w[..., None] * mean + (side * np.cos(turn))[..., None] * across + (side * np.sin(turn))[..., None] * up).reshape(
        -1, 3
    )
    expected = harmonics(samples.T).mean(-1)
    encoded = encoded_in_float32(mean[:, None], roughness)[:, 0]
    allowed = 0.6 * orders() * (orders() + 1) * roughness**2 + 1e-3  # the grid's own error at 600 quantiles
    assert (np.abs(encoded - expected) < allowed).all()
    assert np.abs(expected - harmonics(mean[:, None])[:, 0]).max() > 0.1, "the lobe must be wide enough to matter"


def test_poles_and_rough_lobes_have_finite_values_and_gradients() -> None:
    directions = np.float32(sphere(10))
    gradients = jax.jit(jax.grad(lambda d, r: jnp.sum(integrated_directional_encoding(d, r, DEGREE)), argnums=(0, 1)))
    for roughness in (0.0, 1.0, 1e4, 1e30):
        assert all(np.isfinite(g).all() for g in gradients(directions, np.full(10, roughness, np.float32)))
    np.testing.assert_array_equal(encoded_in_float32(directions, 1e30), 0)
