"""March, draw and pack by compiled loops against `reconstruct.sampling.packing`."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reconstruct.numerics.compiling import jit
from reconstruct.sampling import compiled as kernels
from reconstruct.sampling.occupancy import Occupancy
from reconstruct.sampling.packing import draw, draw_probability, expected_depth, packed_samples
from reconstruct.sampling.samples import RaySamples
from reconstruct.sampling.steps import Steps
from reconstruct.scene.frustum import Frustum
from reconstruct.scene.rays import Rays
from reconstruct.scene.space import BALL, BOX, Space

pytestmark = pytest.mark.usefixtures("kernels_run")

MARCH_TWIN = jit(expected_depth, static_argnums=4)
MARCH = jit(kernels.expected_depth, static_argnums=4)
STEPS = 96
FRUSTUM = Frustum(((1.0, 0.0, 0.0), (0.0, 0.8, -0.6), (0.0, 0.6, 0.8)), (0.0, 0.0, -1.5), 0.8, 0.4, 0.5, 3.0)


def some_rays(count: int, seed: int = 0, distance: float = 2.5) -> Rays:
    rng = np.random.default_rng(seed)
    origins = rng.normal(size=(count, 3))
    origins *= distance / np.linalg.norm(origins, axis=-1, keepdims=True)
    directions = (rng.uniform(-0.9, 0.9, (count, 3)) - origins) * rng.uniform(0.3, 0.6, (count, 1))
    directions[::8] *= -1
    return Rays(jnp.asarray(origins, jnp.float32), jnp.asarray(directions, jnp.float32), jnp.full(count, 1e-3))


def steps_of(rays: Rays, space: Space) -> Steps:
    return Steps.of(rays, steps=STEPS, space=space, near=0.05, far=100.0)


def some_grid(space: Space, share: float) -> Occupancy:
    """With this share of the cells occupied, and depths of all sizes."""
    made = Occupancy.create(0, grid=32, outer_grid=16, space=space, steps=STEPS, possible=None)
    rng = np.random.default_rng(1)
    flags = jnp.asarray(rng.random(made.depth.shape) < share)
    density = jnp.asarray(rng.exponential(4, made.depth.shape), jnp.float32)
    return eqx.tree_at(lambda one: one.density, made, density).with_occupied(flags)


@functools.partial(jit, static_argnames=("capacity", "most"))
def pack(depth, steps, jitter, offset, order, chosen, *, capacity, most):
    return kernels.packed_samples(depth, order, chosen, steps, jitter, offset, capacity=capacity, max_per_ray=most)


@functools.partial(jit, static_argnames=("capacity", "most"))
def pack_twin(depth, steps, jitter, offset, *, capacity, most):
    probability = draw_probability(depth, most - 1)
    return packed_samples(draw(probability, offset), probability, steps, jitter, capacity=capacity, max_per_ray=most)


def assert_alike(ours: tuple[RaySamples, jax.Array], theirs: tuple[RaySamples, jax.Array]) -> None:
    np.testing.assert_array_equal(ours[1], theirs[1])
    for name in ("ray", "slot", "valid"):
        np.testing.assert_array_equal(getattr(ours[0], name), getattr(theirs[0], name))
    for name in (
        "t",
        "length",
    ):  # far away, 1 / t is the small difference of disparities below 20 = 1 / near: 2e-6 of error times t
        np.testing.assert_allclose(getattr(ours[0], name), getattr(theirs[0], name), rtol=2e-4, atol=2e-6)


def both(depth: jax.Array, rays: Rays, space: Space, capacity: int, most: int, seed: int = 3) -> None:
    count = depth.shape[0]
    jitter, offset = jax.random.uniform(jax.random.key(seed), (2, count))
    steps, order = steps_of(rays, space), jnp.arange(count)
    ours = pack(depth, steps, jitter, offset, order, jnp.int32(count), capacity=capacity, most=most)
    assert_alike(ours, pack_twin(depth, steps, jitter, offset, capacity=capacity, most=most))


@pytest.mark.parametrize("space", [BOX, BALL, FRUSTUM])
@pytest.mark.parametrize("share", [0.0, 0.05, 1.0])
@pytest.mark.parametrize("count", [1, 63, 500])
def test_marching_meets_what_the_twin_meets(space: Space, share: float, count: int) -> None:
    rays, grid = some_rays(count), some_grid(space, share)
    jitter, steps = jax.random.uniform(jax.random.key(2), (count,)), steps_of(rays, space)
    depth, hit = MARCH(grid, rays, steps, jitter, space)
    expected = np.asarray(MARCH_TWIN(grid, rays, steps, jitter, space))
    differing = np.mean(np.asarray(depth) != expected)
    assert differing == 0 if space is BOX else differing < 1e-4  # other roundings: a point on a face may change its cell
    np.testing.assert_array_equal(hit, (np.asarray(depth) > 0).any(-1))


@pytest.mark.parametrize("space", [BOX, BALL])
@pytest.mark.parametrize(("capacity", "most"), [(20000, 64), (300, 32), (40, 40), (1, 2)])
def test_packing_equals_the_twin(space: Space, capacity: int, most: int) -> None:
    rays = some_rays(200)
    steps = steps_of(rays, space)
    depth, _ = MARCH(some_grid(space, 0.1), rays, steps, jnp.full(200, 0.5), space)
    both(depth, rays, space, capacity, most)


def test_packing_equals_the_twin_in_a_frustum() -> None:
    depth = jnp.where(jax.random.uniform(jax.random.key(0), (100, STEPS)) < 0.3, 0.2, 0.0)
    both(depth, some_rays(100), FRUSTUM, 3000, 24)


@pytest.mark.parametrize("value", [0.0, 1e-4, 1.0, 60.0])
def test_all_empty_and_all_full(value: float) -> None:
    rays = some_rays(50)
    both(jnp.full((50, STEPS), value, jnp.float32), rays, BOX, 2000, 33)


@given(st.integers(0, 10000), st.floats(0.01, 1.0), st.sampled_from([2, 5, 17, 64]))
def test_random_depths(seed: int, share: float, most: int) -> None:
    """A running sum may round across an integer; at most a sample of a thousand changes its step then."""
    rng = np.random.default_rng(seed)
    depth = rng.choice([0.02, 0.3, 1.0], (40, STEPS)) * (rng.random((40, STEPS)) < share)
    jitter, offset = jax.random.uniform(jax.random.key(seed), (2, 40))
    given_, steps = jnp.asarray(depth, jnp.float32), steps_of(some_rays(40, seed), BOX)
    ours, fits = pack(given_, steps, jitter, offset, jnp.arange(40), jnp.int32(40), capacity=3000, most=most)
    theirs, expected = pack_twin(given_, steps, jitter, offset, capacity=3000, most=most)
    np.testing.assert_array_equal(fits, expected)
    counts = [np.bincount(np.asarray(one.ray)[np.asarray(one.valid)], minlength=40) for one in (ours, theirs)]
    assert np.abs(counts[0] - counts[1]).sum() <= 1
    if (counts[0] == counts[1]).all():
        assert np.mean(np.abs(np.asarray(ours.t - theirs.t)) > 1e-5) <= 2e-3


def test_draws_have_their_probabilities() -> None:
    rng = np.random.default_rng(3)
    depth = jnp.asarray(rng.choice([0, 0.01, 0.3, 1.0], (16, STEPS), p=[0.7, 0.2, 0.07, 0.03]), jnp.float32)
    rays = Rays(jnp.tile(jnp.array([0.1, 0.2, -2.5]), (16, 1)), jnp.tile(jnp.array([0.0, 0.0, 1.0]), (16, 1)), jnp.full(16, 1e-3))
    steps, drawn = steps_of(rays, BOX), np.zeros((16, STEPS))
    for offset in (np.arange(200) + 0.5) / 200:
        middle, row = jnp.full(16, 0.5), jnp.full(16, offset, jnp.float32)
        samples, _ = pack(depth, steps, middle, row, jnp.arange(16), jnp.int32(16), capacity=400, most=17)
        valid = np.asarray(samples.valid)
        step = np.floor((np.asarray(samples.t) - 1.5) / 2 * STEPS).astype(int)
        np.add.at(drawn, (np.asarray(samples.ray)[valid], step[valid]), 1 / 200)
    np.testing.assert_allclose(drawn, draw_probability(depth, 16), atol=3 / 200)  # a grid of 200 offsets


def test_rows_are_read_where_they_are() -> None:
    """Rays in another order, the last of which are none: as if their rows had been gathered first."""
    depth = jnp.where(jax.random.uniform(jax.random.key(0), (60, STEPS)) < 0.2, 0.3, 0.0)
    order = jax.random.permutation(jax.random.key(1), 60)[:40]
    rays, (jitter, offset) = some_rays(40), jax.random.uniform(jax.random.key(2), (2, 40))
    steps = steps_of(rays, BOX)
    ours = pack(depth, steps, jitter, offset, order, jnp.int32(25), capacity=500, most=24)
    gathered = jnp.where(jnp.arange(40)[:, None] < 25, depth[order], 0)
    assert_alike(ours, pack_twin(gathered, steps, jitter, offset, capacity=500, most=24))


@pytest.mark.parametrize("space", [BOX, BALL, FRUSTUM])
def test_pictures_show_what_is_marched_and_packed(space: Space) -> None:
    rays, grid, most = some_rays(300), some_grid(space, 0.1), 24
    steps, middle = steps_of(rays, space), jnp.full(300, 0.5)
    shown = jit(lambda: kernels.shown_samples(grid, rays, steps, space, max_per_ray=most))()
    depth, _ = MARCH(grid, rays, steps, middle, space)
    room = {"capacity": 300 * most, "most": most}
    packed, _ = pack(depth, steps, middle, middle, jnp.arange(300), jnp.int32(300), **room)
    np.testing.assert_array_equal(shown.valid.reshape(300, most), packed.padded(jnp.ones_like(packed.t)) > 0)
    for name in ("t", "length"):
        np.testing.assert_array_equal(shown.padded(getattr(shown, name)), packed.padded(getattr(packed, name)), err_msg=name)


def test_runs_repeat_to_the_bit() -> None:
    rays, grid = some_rays(2048), some_grid(BALL, 0.1)
    jitter, offset = jax.random.uniform(jax.random.key(2), (2, 2048))
    steps, order = steps_of(rays, BALL), jnp.arange(2048)

    def once() -> list[np.ndarray]:
        depth, hit = MARCH(grid, rays, steps, jitter, BALL)
        packed = pack(depth, steps, jitter, offset, order, jnp.int32(2048), capacity=8192, most=64)
        return [np.asarray(one) for one in jax.tree.leaves((depth, hit, packed))]

    first = once()
    for _ in range(10):
        for one, other in zip(first, once(), strict=True):
            np.testing.assert_array_equal(one, other)
