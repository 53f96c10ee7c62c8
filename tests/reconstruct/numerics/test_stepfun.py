import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kstest

from koala3d.reconstruct.numerics.stepfun import (
    inverse_power_ladder,
    power_ladder,
    resample_blurred,
    sample_intervals,
    sum_of_boxes_cdf,
)

SAMPLE = jax.jit(sample_intervals, static_argnums=3)
RESAMPLE = jax.jit(resample_blurred, static_argnums=3)


@pytest.mark.parametrize(("power", "premultiplier"), [(-1.5, 2.0), (-0.25, 1e4), (0.5, 1.0), (-1.0, 1.0)])
def test_ladder_equals_its_formula_and_has_an_inverse(power: float, premultiplier: float) -> None:
    x = np.concatenate([[0.0], np.geomspace(1e-6, 100, 200)])
    scale = abs(power - 1)
    expected = scale / power * ((x * premultiplier / scale + 1) ** power - 1)
    y = power_ladder(jnp.asarray(x, jnp.float32), power, premultiplier)
    np.testing.assert_allclose(y, expected, rtol=3e-6)
    assert (np.diff(y) >= 0).all()
    # near its end the ladder is flat: an error of 1e-7 in y is one of 1e-7 / slope in x
    slope = premultiplier * (x * premultiplier / scale + 1) ** (power - 1)
    back = inverse_power_ladder(y, power, premultiplier)
    assert (np.abs(back - x) <= 1e-5 * x + 3e-7 * np.abs(expected) / slope).all()


def test_inverse_ladder_is_finite_beyond_its_end() -> None:
    assert np.isfinite(inverse_power_ladder(jnp.array([1.6, 1.67, 2.0, 1e6]), -1.5, 2.0)).all()


@given(st.integers(0, 2**32 - 1), st.sampled_from(["even", "clustered", "repeated"]), st.floats(0, 1))
def test_sampled_edges_ascend_and_stay_in_range(seed: int, edges: str, empty: float) -> None:
    rng = np.random.default_rng(seed)
    inner = {
        "even": np.linspace(0, 1, 18)[1:-1],
        "clustered": 0.3 + 1e-4 * rng.random(16),
        "repeated": rng.choice([0.2, 0.5, 0.9], 16),
    }
    t = np.sort(np.concatenate([[0, 1], inner[edges]]))[None].repeat(4, 0).astype(np.float32)
    w = (rng.random((4, 17)) ** 8 * (rng.random((4, 17)) > empty)).astype(np.float32)
    sampled = np.asarray(SAMPLE(jnp.asarray(rng.random(4), jnp.float32), jnp.asarray(t), jnp.asarray(w), 32))
    assert sampled.shape == (4, 33)
    assert np.isfinite(sampled).all()
    assert (np.diff(sampled, axis=-1) >= 0).all()
    assert sampled.min() >= 0
    assert sampled.max() <= 1


def test_draws_follow_the_histogram() -> None:
    """Centres of intervals, pooled over jitters, are distributed as the histogram: Kolmogorov-Smirnov on 4000 stratified rays."""
    t, w = np.array([0, 0.1, 0.4, 0.5, 1.0]), np.array([0.1, 0.0, 0.6, 0.3])
    uniforms = (np.arange(4000) + 0.5) / 4000
    rays = [jnp.asarray(np.tile(a, (4000, 1)), jnp.float32) for a in (t, w)]
    edges = np.asarray(SAMPLE(jnp.asarray(uniforms, jnp.float32), *rays, 16))
    # an edge is the mean of two draws: draw centres are recovered from the distribution of edges at many samples per ray
    many = np.asarray(SAMPLE(jnp.asarray(uniforms[::40], jnp.float32), rays[0][:100], rays[1][:100], 512))
    cdf = lambda x: np.interp(x, t, np.concatenate([[0], np.cumsum(w)]))  # noqa: E731
    statistic = kstest(many[:, 1:-1].reshape(-1), cdf).statistic
    assert statistic < 1 / 512 + 1e-3  # edges straddle at most one interval of probability 1/512
    inside = np.diff(cdf(edges), axis=-1)
    assert np.median(np.abs(inside - 1 / 16)) < 1e-4, "each interval holds an equal share"


def test_weightless_rays_are_sampled_evenly() -> None:
    sampled = SAMPLE(jnp.array([0.5]), jnp.array([[0.0, 0.2, 0.7, 1.0]]), jnp.zeros((1, 3)), 4)
    np.testing.assert_allclose(sampled, [[0, 0.25, 0.5, 0.75, 1.0]], atol=1e-6)


def test_one_ray_by_hand() -> None:
    """Half the weight in [0, 1], half in [3, 4]; draws at probabilities 1/8, 3/8, 5/8, 7/8 fall at 1/4, 3/4, 3 1/4, 3 3/4."""
    sampled = SAMPLE(jnp.array([0.5]), jnp.array([[0.0, 1.0, 3.0, 4.0]]), jnp.array([[0.5, 0.0, 0.5]]), 4)
    np.testing.assert_allclose(sampled, [[0, 0.5, 2, 3.5, 4]], atol=1e-6)


def test_sum_of_boxes_has_the_trapezoid_as_density() -> None:
    x = np.linspace(-2, 2, 4001)
    for first in (0.0, 1e-6, 0.3, 1.0, 2.5):
        cdf = np.asarray(sum_of_boxes_cdf(jnp.asarray(x, jnp.float32), jnp.asarray(first, jnp.float32), 1.0))
        draws = ((np.arange(2000) + 0.5) / 2000 - 0.5) * first
        expected = np.clip(x[:, None] - draws + 0.5, 0, 1).mean(-1)
        np.testing.assert_allclose(cdf, expected, atol=2e-6)  # the midpoint rule's error is 1 / (24 2000^2) of the kink


def dense_resampled(query: np.ndarray, t: np.ndarray, w: np.ndarray, half_width: float, draws: int = 2000) -> np.ndarray:
    """Every interval as many point masses, each blurred by the box on its own."""
    points = t[:-1, None] + np.diff(t)[:, None] * (np.arange(draws) + 0.5) / draws
    below = np.clip((query[:, None, None] - points + half_width) / (2 * half_width), 0, 1).mean(-1)
    return np.diff(below @ w)


@pytest.mark.parametrize("width", [0.5, 0.05, 1e-3, 1e-5, 0.0])
@pytest.mark.parametrize("half_width", [0.03, 0.003])
def test_blurred_weights_equal_a_dense_convolution(width: float, half_width: float) -> None:
    """Down to intervals of no length at all, where the weight sits in one point."""
    rng = np.random.default_rng(5)
    t = np.sort(np.concatenate([[0, 1], 0.4 + width * (rng.random(15) - 0.5)])).astype(np.float32)
    w = rng.random(16).astype(np.float32)
    w[[0, 15]] = 0.01, 0.02
    query = np.linspace(0, 1, 65).astype(np.float32)
    resampled = RESAMPLE(*(jnp.asarray(a[None]) for a in (query, t, w)), half_width)[0]
    exact = dense_resampled(query.astype(np.float64), t.astype(np.float64), w.astype(np.float64), half_width)
    np.testing.assert_allclose(resampled, exact, atol=3e-6)  # float32 sums of 16 weights of order one
    assert resampled.min() >= 0


def test_blurring_keeps_the_weight_that_stays_within_reach() -> None:
    t, w = jnp.array([[0.2, 0.3, 0.3, 0.7]]), jnp.array([[0.3, 0.25, 0.4]])
    resampled = RESAMPLE(jnp.linspace(0, 1, 33)[None], t, w, 0.03)
    np.testing.assert_allclose(resampled.sum(), 0.95, atol=1e-6)


def test_blurred_weights_have_finite_gradients() -> None:
    t = jnp.array([[0.0, 0.3, 0.3, 1.0]])
    gradient = jax.grad(lambda w, t: jnp.sum(jnp.square(RESAMPLE(jnp.linspace(0, 1, 9)[None], t, w, 0.03))), argnums=(0, 1))(
        jnp.ones((1, 3)) / 3, t
    )
    assert all(np.isfinite(g).all() for g in gradient)
