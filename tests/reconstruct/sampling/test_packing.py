import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.sampling.occupancy import Occupancy
from koala3d.reconstruct.sampling.packing import (
    LEAST_IMPORTANCE,
    draw,
    draw_probability,
    expected_depth,
    packed_samples,
    select_bit,
)
from koala3d.reconstruct.sampling.samples import RaySamples
from koala3d.reconstruct.sampling.steps import FRONT, Steps
from koala3d.reconstruct.scene.space import BALL, BOX
from tests import drawn

PACK = jax.jit(packed_samples, static_argnames=("capacity", "max_per_ray"))
DEPTH = jax.jit(expected_depth, static_argnums=4)
PROBABILITY = jax.jit(draw_probability, static_argnums=1)
WITH = jax.jit(Occupancy.with_occupied)


def bits(words: np.ndarray) -> np.ndarray:
    """(n, 32 words) booleans, lowest bit first."""
    return ((np.asarray(words)[..., None] >> np.arange(32, dtype=np.uint32)) & 1).astype(bool).reshape(len(words), -1)


def words_of(flags: np.ndarray) -> jax.Array:
    """Inverse of `bits`."""
    powers = np.uint32(1) << np.arange(32, dtype=np.uint32)
    return drawn.array((flags.reshape(len(flags), -1, 32) * powers).sum(-1, dtype=np.uint32), np.uint32)


def test_selected_bits_equal_a_search() -> None:
    rng = np.random.default_rng(0)
    flags = rng.random((300, 96)) < rng.choice([0.02, 0.3, 0.98], (300, 1))
    flags[0], flags[1], flags[2] = True, False, False
    flags[1, 95] = flags[2, 0] = True
    flags = flags[flags.any(-1)]
    ranks = np.array([rng.integers(row.sum()) for row in flags])
    expected = [np.flatnonzero(row)[rank] for row, rank in zip(flags, ranks, strict=True)]
    np.testing.assert_array_equal(jax.jit(select_bit)(words_of(flags), ranks.astype(np.int32)), expected)


def test_a_camera_inside_the_ball_has_no_steps_of_no_length(some_rays, steps_of) -> None:
    """Nothing lies between the near plane and the ball there, so that nothing may be drawn from it."""
    rays = some_rays(16, distance=0.3)
    steps = steps_of(rays, bounded=False)
    np.testing.assert_array_equal(steps.enter, steps.near)
    occupancy = Occupancy.create(0, grid=16, outer_grid=8, space=BALL, steps=32, possible=None)
    middle = np.full(16, 0.5, np.float32)
    depth = np.asarray(DEPTH(occupancy, rays, steps, middle, BALL))
    assert not (depth[:, :FRONT] > 0).any()
    assert (depth[:, FRONT:] > 0).any(-1).all()

    @jax.jit
    def packed(depth: jax.Array) -> RaySamples:
        probability = draw_probability(depth, 160)
        drawn_words = draw(probability, jnp.asarray(middle))
        return packed_samples(drawn_words, probability, steps, jnp.asarray(middle), capacity=16 * 160, max_per_ray=160)[0]

    samples = packed(depth)
    assert (np.asarray(samples.length)[np.asarray(samples.valid)] > 0).all()


@pytest.mark.parametrize("bounded", [True, False])
def test_expected_depth_equals_a_loop(bounded: bool, some_rays, steps_of) -> None:
    rays, grid, outer = some_rays(24), 12, 10
    occupancy = Occupancy.create(0, grid=grid, outer_grid=outer, space=BOX if bounded else BALL, steps=32, possible=None)
    rng = np.random.default_rng(1)
    flags = rng.random(occupancy.occupied.shape) < 0.4
    occupancy = WITH(occupancy, flags)
    steps, jitter = steps_of(rays, bounded, 32), np.float32(rng.random(24))
    found = np.asarray(DEPTH(occupancy, rays, steps, jitter, BOX if bounded else BALL)) > 0
    t = np.asarray(jax.jit(Steps.at)(steps, np.float32(np.arange(steps.count) + jitter[:, None])), np.float64)
    origins, directions = np.asarray(rays.origins, np.float64), np.asarray(rays.directions, np.float64)
    missed = np.asarray(steps.leave) <= np.asarray(steps.enter)
    clear = occupied = 0
    for ray in range(24):
        for step in range(steps.count):
            if missed[ray] and (bounded or FRONT <= step < FRONT + 32):
                assert not found[ray, step]
                continue
            point = origins[ray] + t[ray, step] * directions[ray]
            radius = np.linalg.norm(point)
            point = point if bounded or radius <= 1 else (2 - 1 / radius) * point / radius
            inner = bounded or np.abs(point).max() < 1
            size, reach = (grid, 1.0) if inner else (outer, 2.0)
            place = (point / reach + 1) / 2 * size
            if np.abs(place - np.round(place)).min() < 1e-4 or abs(np.abs(point).max() - 1) < 1e-5:
                continue  # float32 may take the neighbouring cell
            i, j, k = np.clip(np.floor(place), 0, size - 1).astype(int)
            index = (i * size + j) * size + k + (0 if inner else grid**3)
            assert found[ray, step] == flags[index], (ray, step)
            clear, occupied = clear + 1, occupied + int(found[ray, step])
    assert clear > 300
    assert 0.2 < occupied / clear < 0.6


def some_depths(count: int = 40, steps: int = 192) -> np.ndarray:
    """Optical depths with everything: fog, a thin film before a wall, one step alone, nothing."""
    rng = np.random.default_rng(3)
    depth = rng.choice([0, 0.01, 0.3, 1.0], (count, steps), p=[0.7, 0.2, 0.07, 0.03])
    depth[0], depth[1], depth[2] = 0, 0.02, 0
    depth[2, 77] = 0.5
    depth[3], depth[3, 20], depth[3, 60:] = 0, 0.1, 1
    return depth.astype(np.float32)


def test_probabilities_follow_what_each_step_shows_and_sum_to_what_is_wanted() -> None:
    depth = some_depths()
    wanted = 16
    found = np.asarray(PROBABILITY(depth, wanted), np.float64)
    exact = depth.astype(np.float64)
    importance = np.where(exact > 0, exact * np.exp(-(np.cumsum(exact, -1) - exact)) + LEAST_IMPORTANCE, 0)
    assert ((found > 0) == (exact > 0)).all()
    assert found.max() <= 1
    for row, shares in zip(importance, found, strict=True):
        occupied = (row > 0).sum()
        # three rounds leave a little to give where many steps are certain: a sixteenth of one sample
        assert abs(shares.sum() - min(wanted, occupied)) < 1 / 16
        open_steps = (shares > 0) & (shares < 1)
        if open_steps.any():
            ratio = shares[open_steps] / row[open_steps]
            np.testing.assert_allclose(ratio, ratio[0], rtol=1e-4)  # float32 sums over 192 steps


def test_draws_have_their_probabilities_and_keep_the_length() -> None:
    """Over evenly spread offsets each step is drawn as often as its probability says, at most once, and as many in all."""
    depth = some_depths()
    probability = PROBABILITY(depth, 16)
    offsets = np.float32((np.arange(500) + 0.5) / 500)
    words = jax.jit(jax.vmap(lambda o: draw(probability, jnp.full(depth.shape[0], o))))(offsets)
    flags = np.stack([bits(one) for one in np.asarray(words)])
    # an offset grid of 1/500 and float32 sums up to 16 with 2e-6 of rounding
    np.testing.assert_allclose(flags.mean(0), probability, atol=3 / 500)
    counts = flags.sum(-1)
    assert (np.abs(counts - np.asarray(probability).sum(-1)) <= 1).all()


@pytest.mark.parametrize(("capacity", "max_per_ray"), [(2000, 96), (100, 96), (45, 40)])
def test_packed_samples_equal_a_loop(capacity: int, max_per_ray: int, some_rays, steps_of) -> None:
    rng = np.random.default_rng(2)
    rays = some_rays(12, distance=2.5)
    steps = steps_of(rays, bounded=True, steps=96)
    flags = rng.random((12, 96)) < rng.choice([0, 0.1, 0.3, 0.4], (12, 1))
    flags[3] = False
    flags[np.asarray(steps.leave) <= np.asarray(steps.enter)] = False
    probability = rng.uniform(0.1, 1.0, (12, 96)).astype(np.float32)
    jitter = rng.uniform(0.01, 0.99, 12).astype(np.float32)
    samples, fits = PACK(words_of(flags), probability, steps, jitter, capacity=capacity, max_per_ray=max_per_ray)
    rows, expected_fits, used = [], [], 0
    enter, leave = np.asarray(steps.enter, np.float64), np.asarray(steps.leave, np.float64)
    at = lambda u, ray: enter[ray] + (leave[ray] - enter[ray]) * u / steps.inside  # noqa: E731
    for ray, row in enumerate(flags):
        found = np.flatnonzero(row)[:max_per_ray]
        used += len(found)
        expected_fits.append(used <= capacity)
        for slot, step in enumerate(found if expected_fits[-1] else []):
            length = (at(step + 1, ray) - at(step, ray)) / probability[ray, step]
            rows.append((ray, slot, at(step + jitter[ray], ray), length))
    np.testing.assert_array_equal(fits, expected_fits)
    if capacity < 200:
        assert not all(expected_fits), "the list must overflow"
    valid = np.asarray(samples.valid)
    assert samples.ray.shape == (capacity,)
    assert valid.sum() == len(rows)
    ours = np.stack([np.asarray(a, np.float64)[valid] for a in (samples.ray, samples.slot, samples.t, samples.length)], -1)
    np.testing.assert_array_equal(ours[:, :2], np.array(rows)[:, :2])
    np.testing.assert_allclose(ours[:, 2:], np.array(rows)[:, 2:], atol=2e-5)  # float32 differences of t up to 4, lengthened
    np.testing.assert_array_equal(np.asarray(samples.length)[~valid], 0)


def test_the_optical_depth_of_a_ray_keeps_its_expected_value(some_rays, steps_of) -> None:
    """What importance sampling promises: over offsets, drawn lengths times density average to the whole ray's."""
    rays = some_rays(9, distance=2.5)
    steps = steps_of(rays, bounded=True, steps=192)
    enter, leave = np.asarray(steps.enter), np.asarray(steps.leave)
    hits = leave > enter
    depth = some_depths(9) * hits[:, None]
    probability = PROBABILITY(depth, 16)
    density = np.float32(np.random.default_rng(4).uniform(0, 3, 192))

    def total(offset: jax.Array) -> jax.Array:
        middle = jnp.full(9, 0.5)
        samples, _ = packed_samples(
            draw(probability, jnp.full(9, offset)), probability, steps, middle, capacity=400, max_per_ray=32
        )
        step = (samples.t - steps.enter[samples.ray]) / jnp.maximum(steps.leave - steps.enter, 1e-6)[samples.ray] * 192
        met = jnp.asarray(density)[jnp.clip(step.astype(jnp.int32), 0, 191)]
        return samples.padded(met * samples.length).sum(-1)

    offsets = np.float32((np.arange(400) + 0.5) / 400)
    mean = np.asarray(jax.jit(lambda o: jax.lax.map(total, o))(offsets)).mean(0)
    expected = ((depth > 0) * density).sum(-1) * (leave - enter) / 192
    np.testing.assert_allclose(
        mean[hits], expected[hits], rtol=0.02
    )  # a step of probability 0.05 is met by 20 of 400 offsets +-1
