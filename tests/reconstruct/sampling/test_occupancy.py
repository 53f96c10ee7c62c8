import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reconstruct.contraction import contract
from reconstruct.rays import Rays
from reconstruct.sampling.occupancy import BEHIND, FRONT, Occupancy, Steps, occupied_steps, packed_samples, select_bit

PACK = jax.jit(packed_samples, static_argnames=("capacity", "max_per_ray"))
STEPS = jax.jit(occupied_steps, static_argnums=4)


def bits(words: np.ndarray) -> np.ndarray:
    """(n, 32 words) booleans, lowest bit first."""
    return ((np.asarray(words)[..., None] >> np.arange(32, dtype=np.uint32)) & 1).astype(bool).reshape(len(words), -1)


def words_of(flags: np.ndarray) -> jax.Array:
    """Inverse of `bits`."""
    powers = np.uint32(1) << np.arange(32, dtype=np.uint32)
    return jnp.asarray((flags.reshape(len(flags), -1, 32) * powers).sum(-1, dtype=np.uint32))


def some_rays(count: int, seed: int = 0, distance: float = 3.0) -> Rays:
    """From all around towards points near the origin; every eighth looks away, and one lies along an axis."""
    rng = np.random.default_rng(seed)
    origins = rng.normal(size=(count, 3))
    origins *= distance / np.linalg.norm(origins, axis=-1, keepdims=True)
    directions = (rng.uniform(-0.8, 0.8, (count, 3)) - origins) * rng.uniform(0.3, 0.6, (count, 1))
    directions[::8] *= -1
    origins[1], directions[1] = [0.1, -distance, 0.2], [0, 1.0, 0]
    return Rays(*(jnp.asarray(a, jnp.float32) for a in (origins, directions)), jnp.full(count, 1e-3))


def steps_of(rays: Rays, bounded: bool, steps: int = 64) -> Steps:
    return Steps.of(rays, steps=steps, bounded=bounded, near=0.05, far=100.0)


def test_selected_bits_equal_a_search() -> None:
    rng = np.random.default_rng(0)
    flags = rng.random((300, 96)) < rng.choice([0.02, 0.3, 0.98], (300, 1))
    flags[0], flags[1], flags[2] = True, False, False
    flags[1, 95] = flags[2, 0] = True
    flags = flags[flags.any(-1)]
    ranks = np.array([rng.integers(row.sum()) for row in flags])
    expected = [np.flatnonzero(row)[rank] for row, rank in zip(flags, ranks, strict=True)]
    np.testing.assert_array_equal(select_bit(words_of(flags), jnp.asarray(ranks, jnp.int32)), expected)


@pytest.mark.parametrize("bounded", [True, False])
def test_steps_ascend_and_cover_what_they_promise(bounded: bool) -> None:
    rays = some_rays(64)
    steps = steps_of(rays, bounded)
    t = np.asarray(steps.at(jnp.broadcast_to(jnp.linspace(0, steps.count, 500), (64, 500))), np.float64)
    assert np.isfinite(t).all()
    assert (np.diff(t, axis=-1) >= -1e-5).all()  # rounding at the joints of the parts, t up to 100
    assert (t[:, 0] >= 0.05 - 1e-6).all()
    points = np.asarray(rays.origins)[:, None] + t[..., None] * np.asarray(rays.directions)[:, None]
    if bounded:
        hits = np.asarray(steps.leave > steps.enter)
        assert 40 < hits.sum() < 64, "some rays hit and some miss"
        assert np.abs(points[hits]).max() <= 1 + 1e-5
        surface = np.abs(points[hits][:, [0, -1]]).max(-1)
        np.testing.assert_allclose(surface, 1, atol=1e-5)
    else:
        assert steps.count == FRONT + 64 + BEHIND
        np.testing.assert_allclose(t[:, 0], 0.05, atol=1e-6)
        np.testing.assert_allclose(t[:, -1], 100, rtol=1e-5)
        hits = np.asarray(steps.leave > steps.enter)
        ends = (
            np.asarray(rays.origins)[:, None]
            + np.stack([steps.enter, steps.leave], -1)[..., None] * np.asarray(rays.directions)[:, None]
        )
        np.testing.assert_allclose(np.linalg.norm(ends[hits], axis=-1), 1, atol=1e-5)


@pytest.mark.parametrize("bounded", [True, False])
def test_steps_of_single_entries_equal_those_of_rows(bounded: bool) -> None:
    rays = some_rays(16)
    steps = steps_of(rays, bounded)
    u = jnp.broadcast_to(jnp.linspace(0, steps.count, 33), (16, 33))
    entries = steps.at(u.reshape(-1), jnp.repeat(jnp.arange(16), 33))
    np.testing.assert_allclose(entries.reshape(16, 33), steps.at(u), rtol=1e-6)


def test_a_camera_inside_the_ball_has_no_steps_of_no_length() -> None:
    """Nothing lies between the near plane and the ball there, so that no bit may be set for it."""
    rays = some_rays(16, distance=0.3)
    steps = steps_of(rays, bounded=False)
    assert (steps.enter == steps.near).all()
    occupancy = Occupancy.create(jax.random.key(0), grid=16, outer_grid=8, bounded=False, possible=None)
    words = STEPS(occupancy, rays, steps, jnp.full(16, 0.5), False)
    assert not bits(words)[:, :FRONT].any()
    assert bits(words)[:, FRONT:].any(-1).all()
    samples, _ = PACK(words, steps, jnp.full(16, 0.5), capacity=16 * 160, max_per_ray=160)
    assert (samples.length[samples.valid] > 0).all()


@pytest.mark.parametrize("bounded", [True, False])
def test_occupied_steps_equal_a_loop(bounded: bool) -> None:
    rays, grid, outer = some_rays(24), 12, 10
    occupancy = Occupancy.create(jax.random.key(0), grid=grid, outer_grid=outer, bounded=bounded, possible=None)
    rng = np.random.default_rng(1)
    flags = rng.random(occupancy.occupied.shape) < 0.4
    occupancy = occupancy.with_occupied(jnp.asarray(flags, jnp.uint8))
    steps, jitter = steps_of(rays, bounded, 32), jnp.asarray(rng.random(24), jnp.float32)
    found = bits(STEPS(occupancy, rays, steps, jitter, bounded))
    t = np.asarray(steps.at(jnp.arange(steps.count) + jitter[:, None]))
    clear = set_bits = 0
    for ray in range(24):
        for step in range(steps.count):
            if float(steps.leave[ray]) <= float(steps.enter[ray]) and (bounded or FRONT <= step < FRONT + 32):
                assert not found[ray, step]
                continue
            point = np.asarray(rays.origins[ray], np.float64) + t[ray, step].astype(np.float64) * np.asarray(
                rays.directions[ray], np.float64
            )
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
            clear, set_bits = clear + 1, set_bits + int(found[ray, step])
    assert clear > 300
    assert 0.2 < set_bits / clear < 0.6


def plain_packing(flags: np.ndarray, steps: Steps, jitter: np.ndarray, capacity: int, max_per_ray: int) -> tuple[list, list]:
    """The definition, one sample after the other: (ray, slot, t, length) and which rays fit."""
    rows, fits, used = [], [], 0
    enter, leave = np.asarray(steps.enter, np.float64), np.asarray(steps.leave, np.float64)
    at = lambda u, ray: enter[ray] + (leave[ray] - enter[ray]) * u / steps.inside  # noqa: E731
    for ray, row in enumerate(flags):
        found = np.flatnonzero(row)
        kept = min(len(found), max_per_ray)
        used += kept
        fits.append(used <= capacity)
        if not fits[-1]:
            continue
        for slot in range(kept):
            thinning = len(found) / kept
            step = found[min(int((slot + jitter[ray]) * thinning), len(found) - 1)]
            rows.append((ray, slot, at(step + jitter[ray], ray), (at(step + 1, ray) - at(step, ray)) * thinning))
    return rows, fits


@pytest.mark.parametrize(("capacity", "max_per_ray"), [(2000, 96), (2000, 7), (150, 96), (45, 10)])
def test_packed_samples_equal_a_loop(capacity: int, max_per_ray: int) -> None:
    rng = np.random.default_rng(2)
    rays = some_rays(12, distance=2.5)
    steps = steps_of(rays, bounded=True, steps=96)
    flags = rng.random((12, 96)) < rng.choice([0, 0.1, 0.5, 0.9], (12, 1))
    flags[3], flags[4] = False, True
    flags[np.asarray(steps.leave <= steps.enter)] = False
    jitter = rng.uniform(0.01, 0.99, 12).astype(np.float32)
    samples, fits = PACK(words_of(flags), steps, jnp.asarray(jitter), capacity=capacity, max_per_ray=max_per_ray)
    rows, expected_fits = plain_packing(flags, steps, jitter, capacity, max_per_ray)
    np.testing.assert_array_equal(fits, expected_fits)
    if capacity < 200:
        assert not all(expected_fits), "the list must overflow"
    assert samples.ray.shape == (capacity,)
    valid = np.asarray(samples.valid)
    assert valid.sum() == len(rows)
    ours = np.stack([np.asarray(a, np.float64)[valid] for a in (samples.ray, samples.slot, samples.t, samples.length)], -1)
    np.testing.assert_array_equal(ours[:, :2], np.array(rows)[:, :2])
    np.testing.assert_allclose(ours[:, 2:], np.array(rows)[:, 2:], atol=2e-5)  # float32 differences of t up to 4, lengthened
    assert (np.diff(ours[:, 2])[np.diff(ours[:, 0]) == 0] > 0).all(), "samples of a ray ascend"
    np.testing.assert_array_equal(np.asarray(samples.length)[~valid], 0)


def test_thinning_keeps_the_occupied_length() -> None:
    rays = some_rays(9, distance=2.5)
    steps = steps_of(rays, bounded=True, steps=96)
    words = words_of(np.ones((9, 96), bool))
    samples, _ = PACK(words, steps, jnp.full(9, 0.3), capacity=200, max_per_ray=11)
    total = samples.padded(samples.length).sum(-1)
    np.testing.assert_allclose(total, steps.leave - steps.enter, rtol=1e-4)


@pytest.mark.parametrize("bounded", [True, False])
def test_updates_find_a_ball_and_forget_what_has_gone(bounded: bool) -> None:
    occupancy = Occupancy.create(jax.random.key(0), grid=16, outer_grid=8, bounded=bounded, possible=None)
    assert occupancy.occupied.sum() > 2000

    @jax.jit
    def look(occupancy: Occupancy, key: jax.Array, x: float, radius: float) -> Occupancy:
        return occupancy.updated(
            lambda p: jnp.where(jnp.linalg.norm(p - jnp.array([[1.0], [0], [0]]) * x, axis=0) < radius, 50.0, 0.0),
            key,
            1500,
            0.01,
        )

    for key in jax.random.split(jax.random.key(1), 120):
        occupancy = look(occupancy, key, 0.0, 0.5)
    at = lambda *p: int(occupancy.occupied[occupancy.cell(*jnp.asarray(p, jnp.float32))])  # noqa: E731
    assert at(0.0, 0.0, 0.0) == at(0.3, -0.2, 0.1) == 1
    assert at(0.9, 0.0, 0.0) == at(-0.6, 0.6, 0.6) == 0
    share = float(occupancy.occupied[: 16**3].mean())
    ball_share = 4 / 3 * np.pi * 0.5**3 / 8
    assert ball_share <= share < 2 * ball_share, "the ball's cells and those that it cuts"
    for key in jax.random.split(jax.random.key(2), 120):
        occupancy = look(occupancy, key, 0.7, 0.15)
    assert at(0.7, 0.0, 0.0) == 1
    assert at(0.0, 0.0, 0.0) == at(-0.3, -0.2, 0.1) == 0, "what has gone is forgotten"
    assert occupancy.occupied[: 16**3].mean() < 0.02


def test_update_points_lie_in_their_cells() -> None:
    occupancy = Occupancy.create(jax.random.key(0), grid=6, outer_grid=8, bounded=False, possible=None)
    cells = occupancy.visits
    points = occupancy._points(cells, jax.random.uniform(jax.random.key(1), (3, len(cells)), minval=0.01, maxval=0.99))
    outside = np.asarray(cells) >= 6**3
    covered_twice = outside & (np.abs(points).max(0) < 1)  # the inner grid answers for these
    np.testing.assert_array_equal(occupancy.cell(*points)[~covered_twice], cells[~covered_twice])
    assert (~covered_twice & outside).sum() > 100


def test_masks_rule_cells_out_for_good() -> None:
    possible = np.zeros(8**3, bool)
    possible[100:200] = True
    occupancy = Occupancy.create(jax.random.key(0), grid=8, outer_grid=8, bounded=True, possible=possible)
    look = jax.jit(lambda o, key: o.updated(lambda p: jnp.full(p.shape[1], 1e3), key, 60, 0.01))
    for key in jax.random.split(jax.random.key(1), 4):
        occupancy = look(occupancy, key)
    np.testing.assert_array_equal(np.asarray(occupancy.occupied, bool), possible)


def test_densities_that_training_met_are_kept() -> None:
    occupancy = Occupancy.create(jax.random.key(0), grid=8, outer_grid=8, bounded=True, possible=np.zeros(512, bool))
    occupancy = occupancy.seen(jnp.array([3, 3, 7]), jnp.array([5.0, 2.0, 1.0]))
    np.testing.assert_array_equal(occupancy.density[jnp.array([3, 7, 8])], [5, 1, 0])


def test_the_outer_extent_is_a_step_in_the_scene() -> None:
    """A cell of the contracted surroundings stands for a step that contraction shrinks: checked radially by differences."""
    occupancy = Occupancy.create(jax.random.key(0), grid=8, outer_grid=32, bounded=False, possible=None)
    for radius in (1.2, 2.0, 5.0):
        point = jnp.array([radius, 0.05, 0.05])
        shrink = float((contract(point + jnp.array([0.01, 0, 0])) - contract(point - jnp.array([0.01, 0, 0])))[0]) / 0.02
        cell = occupancy.cell(*contract(point))
        np.testing.assert_allclose(
            occupancy.extent[cell], 4 / 32 / shrink, rtol=0.25
        )  # the cell's centre is up to half a cell away
