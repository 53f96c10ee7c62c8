import jax
import numpy as np
import pytest
from scipy.stats import kstest

from koala3d.reconstruct.config import SurfaceConfig
from koala3d.reconstruct.surface.ball import ball_samples, random_rotations, shell_radii, sphere_directions


@pytest.mark.parametrize("count", [4, 32, 1000])
def test_sphere_directions_are_uniform(count: int) -> None:
    directions = sphere_directions(count)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-12)
    assert np.abs(directions[:, 0]).max() <= 1
    np.testing.assert_allclose(directions[:, 0], 1 - (2 * np.arange(1, count + 1) - 1) / count, atol=1e-12)
    if count >= 32:  # low-discrepancy: moments are those of the sphere far more closely than 1/sqrt(count)
        np.testing.assert_allclose(directions.mean(0), 0, atol=1.5 / count)
        np.testing.assert_allclose(directions.T @ directions / count, np.eye(3) / 3, atol=2 / count)
        cosine = directions @ directions.T - 2 * np.eye(count)
        spacing = np.arccos(cosine.max(-1))
        even = np.sqrt(4 * np.pi / count)  # side of a cell of equal area
        assert spacing.min() > 0.6 * even, "no clusters"
        assert spacing.max() < 1.2 * even, "no holes"


@pytest.mark.parametrize("kappa", [0.5, 5.0, 50.0, 1e4])
def test_concentrated_directions_have_the_lobe_s_moments(kappa: float) -> None:
    """E[w] = coth kappa - 1 / kappa and E[w^2] = 1 - 2 E[w] / kappa (Mardia and Jupp 2000, section 9.3.2)."""
    directions = sphere_directions(4000, kappa)
    first = 1 / np.tanh(kappa) - 1 / kappa
    w = directions[:, 0]
    np.testing.assert_allclose(1 - w.mean(), 1 - first, rtol=1e-3)  # the midpoint rule in probability at 4000 nodes
    np.testing.assert_allclose(1 - np.mean(w**2), 2 * first / kappa, rtol=1e-3)
    assert np.abs(w).max() <= 1
    np.testing.assert_allclose(directions[:, 1:].mean(0), 0, atol=1e-3)


def test_no_concentration_is_the_limit_of_little() -> None:
    uniform = sphere_directions(32)
    for kappa in (1e-12, 1e-7, 1e-6, 1e-5, 1e-4):
        np.testing.assert_allclose(sphere_directions(32, kappa)[:, 0], uniform[:, 0], atol=max(kappa, 1e-9))
        np.testing.assert_allclose(sphere_directions(32, kappa), uniform, atol=max(5 * kappa, 1e-8))


def test_shells_are_the_supplement_s() -> None:
    radii = shell_radii(32)
    np.testing.assert_allclose(radii, [(1 + i % 5) / 5 for i in range(1, 33)])
    np.testing.assert_allclose(np.unique(radii), np.arange(1, 6) / 5)
    assert shell_radii(1).shape == (1,)


def test_random_rotations_are_uniform() -> None:
    """Statistics of 20 000 rotations against Haar's measure, at five standard errors.

    Entries have mean 0 and variance 1/3; the trace is 1 + 2 cos of an angle whose density is (1 - cos) / pi; a second
    rotation from the left changes nothing.
    """
    count = 20_000
    rotations = np.asarray(jax.jit(random_rotations, static_argnums=1)(jax.random.key(0), count), np.float64)
    np.testing.assert_allclose(rotations @ rotations.transpose(0, 2, 1), np.broadcast_to(np.eye(3), rotations.shape), atol=2e-6)
    np.testing.assert_allclose(np.linalg.det(rotations), 1, atol=2e-6)
    assert np.abs(rotations.mean(0)).max() < 5 * np.sqrt(1 / 3 / count)
    spread = 5 * np.sqrt((1 / 5 - 1 / 9) / count)  # entries are uniform on [-1, 1]: E[x^4] = 1/5
    np.testing.assert_allclose((rotations**2).mean(0), 1 / 3, atol=spread)
    for column in rotations.reshape(count, 9).T:
        assert kstest(column, "uniform", args=(-1, 2)).pvalue > 1e-4
    angle = np.arccos(np.clip((np.trace(rotations, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert kstest(angle, lambda a: (a - np.sin(a)) / np.pi).pvalue > 1e-4
    turn = rotations[0] @ rotations
    angle = np.arccos(np.clip((np.trace(turn[1:], axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert kstest(angle, lambda a: (a - np.sin(a)) / np.pi).pvalue > 1e-4


@pytest.mark.parametrize("sampling", ["lattice", "fibonacci", "random"])
def test_ball_samples_are_unit_directions_and_radii(sampling: str) -> None:
    config = SurfaceConfig.model_validate({"samples": 32, "reach": 1.0, "sampling": sampling})
    directions, radii = map(np.asarray, jax.jit(lambda key: ball_samples(key, 400, config))(jax.random.key(0)))
    assert directions.shape == (400, 32, 3) and radii.shape == (32,)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-5)
    np.testing.assert_allclose(radii, 1 if sampling == "fibonacci" else shell_radii(32), atol=1e-6)
    # uniform over rays and samples: means of 12 800 (dependent within a ray: at most 400 free) directions
    assert np.abs(directions.mean((0, 1))).max() < 5 / np.sqrt(3 * 400)
    nearest = np.sort(directions @ directions.transpose(0, 2, 1), -1)[..., -2]
    closest = np.degrees(np.arccos(np.clip(nearest.max(-1), -1, 1))).min()
    assert (closest < 5) == (sampling == "random"), "a lattice keeps its directions apart, chance does not"
