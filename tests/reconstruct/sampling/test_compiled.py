"""March, draw and pack by compiled loops against `reconstruct.sampling.packing`."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from koala3d.reconstruct.numerics.compiling import jit
from koala3d.reconstruct.sampling import compiled as kernels
from koala3d.reconstruct.sampling.occupancy import Occupancy
from koala3d.reconstruct.sampling.packing import draw, draw_probability, expected_depth, packed_samples
from koala3d.reconstruct.sampling.samples import RaySamples
from koala3d.reconstruct.sampling.steps import Steps
from koala3d.reconstruct.scene.frustum import Frustum
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import BALL, BOX, Space
from tests import drawn

pytestmark = pytest.mark.usefixtures("kernels_run")

MARCH_TWIN = jit(expected_depth, static_argnums=4)
MARCH = jit(kernels.expected_depth, static_argnums=4)
STEPS, MARCHED, PACKED = 96, 500, 200
"""Steps of a ray, and rays for which the twins of marching and of packing are compiled: fewer rays are the first of these."""
FRUSTUM = Frustum(((1.0, 0.0, 0.0), (0.0, 0.8, -0.6), (0.0, 0.6, 0.8)), (0.0, 0.0, -1.5), 0.8, 0.4, 0.5, 3.0)


def some_rays(count: int, seed: int = 0, distance: float = 2.5) -> Rays:
    rng = np.random.default_rng(seed)
    origins = rng.normal(size=(count, 3))
    origins *= distance / np.linalg.norm(origins, axis=-1, keepdims=True)
    directions = (rng.uniform(-0.9, 0.9, (count, 3)) - origins) * rng.uniform(0.3, 0.6, (count, 1))
    directions[::8] *= -1
    return Rays(*map(drawn.array, (origins, directions, np.full(count, 1e-3))))


@functools.partial(jax.jit, static_argnums=1)
def steps_of(rays: Rays, space: Space) -> Steps:
    return Steps.of(rays, steps=STEPS, space=space, near=0.05, far=100.0)


@functools.cache
def some_grid(space: Space, share: float) -> Occupancy:
    """With this share of the cells occupied, and depths of all sizes."""
    made = drawn.filled(lambda: Occupancy.create(0, grid=32, outer_grid=16, space=space, steps=STEPS, possible=None))
    rng = np.random.default_rng(1)
    flags = rng.random(made.depth.shape) < share
    density = drawn.array(rng.exponential(4, made.depth.shape))
    made = eqx.tree_at(lambda one: (one.density, one.extent), made, (density, drawn.array(np.full(made.depth.shape, 2 / 32))))
    return jax.jit(Occupancy.with_occupied)(made, flags)


def numbers(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Jitter and offset of each ray."""
    jitter, offset = np.float32(np.random.default_rng(seed).uniform(size=(2, count)))
    return jitter, offset


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


def both(depth: jax.Array | np.ndarray, space: Space, capacity: int, most: int) -> None:
    """Of as many rays as packing is compiled for."""
    jitter, offset = numbers(PACKED, 3)
    steps, order = steps_of(some_rays(PACKED), space), np.arange(PACKED, dtype=np.int32)
    ours = pack(depth, steps, jitter, offset, order, np.int32(PACKED), capacity=capacity, most=most)
    assert_alike(ours, pack_twin(depth, steps, jitter, offset, capacity=capacity, most=most))


@pytest.mark.parametrize("space", [BOX, BALL, FRUSTUM])
@pytest.mark.parametrize("share", [0.0, 0.05, 1.0])
@pytest.mark.parametrize("count", [1, 63, MARCHED])
def test_marching_meets_what_the_twin_meets(space: Space, share: float, count: int) -> None:
    rays, grid, (jitter, _) = some_rays(MARCHED), some_grid(space, share), numbers(MARCHED, 2)
    steps = steps_of(rays, space)
    first = lambda tree: jax.tree.map(lambda one: np.asarray(one)[:count], tree)  # noqa: E731
    depth, hit = MARCH(grid, *first((rays, steps, jitter)), space)
    expected = np.asarray(MARCH_TWIN(grid, rays, steps, jitter, space))[:count]
    differing = np.mean(np.asarray(depth) != expected)
    assert differing == 0 if space is BOX else differing < 1e-4  # other roundings: a point on a face may change its cell
    np.testing.assert_array_equal(hit, (np.asarray(depth) > 0).any(-1))


@pytest.mark.parametrize(
    ("space", "capacity", "most"), [(BOX, 20000, 64), (BOX, 300, 32), (BOX, 40, 40), (BOX, 1, 2), (BALL, 300, 32)]
)
def test_packing_equals_the_twin(space: Space, capacity: int, most: int) -> None:
    rays = some_rays(PACKED)
    depth, _ = MARCH(some_grid(space, 0.1), rays, steps_of(rays, space), np.full(PACKED, 0.5, np.float32), space)
    both(depth, space, capacity, most)


def test_packing_equals_the_twin_in_a_frustum() -> None:
    rng = np.random.default_rng(0)
    both(np.float32(0.2 * (rng.random((PACKED, STEPS)) < 0.3)), FRUSTUM, 3000, 24)


@pytest.mark.parametrize("value", [0.0, 1e-4, 1.0, 60.0])
def test_all_empty_and_all_full(value: float) -> None:
    both(np.full((PACKED, STEPS), value, np.float32), BOX, 300, 32)
    both(np.full((PACKED, STEPS), value, np.float32), BOX, 40, 40)


@given(st.integers(0, 10000), st.floats(0.01, 1.0), st.sampled_from([2, 64]))
def test_random_depths(seed: int, share: float, most: int) -> None:
    """A running sum may round across an integer; at most a sample of a thousand changes its step then."""
    rng = np.random.default_rng(seed)
    depth = np.float32(rng.choice([0.02, 0.3, 1.0], (PACKED, STEPS)) * (rng.random((PACKED, STEPS)) < share))
    (jitter, offset), steps = numbers(PACKED, seed), steps_of(some_rays(PACKED, seed), BOX)
    order = np.arange(PACKED, dtype=np.int32)
    ours, fits = pack(depth, steps, jitter, offset, order, np.int32(PACKED), capacity=20000, most=most)
    theirs, expected = pack_twin(depth, steps, jitter, offset, capacity=20000, most=most)
    np.testing.assert_array_equal(fits, expected)
    counts = [np.bincount(np.asarray(one.ray)[np.asarray(one.valid)], minlength=PACKED) for one in (ours, theirs)]
    assert np.abs(counts[0] - counts[1]).sum() <= 5
    if (counts[0] == counts[1]).all():
        assert np.mean(np.abs(np.asarray(ours.t) - np.asarray(theirs.t)) > 1e-5) <= 2e-3


def test_draws_have_their_probabilities() -> None:
    rng = np.random.default_rng(3)
    depth = np.float32(rng.choice([0, 0.01, 0.3, 1.0], (16, STEPS), p=[0.7, 0.2, 0.07, 0.03]))
    rays = Rays(*map(drawn.array, (np.tile([0.1, 0.2, -2.5], (16, 1)), np.tile([0.0, 0.0, 1.0], (16, 1)), np.full(16, 1e-3))))
    steps, found = steps_of(rays, BOX), np.zeros((16, STEPS))
    order, middle = np.arange(16, dtype=np.int32), np.full(16, 0.5, np.float32)
    for offset in (np.arange(200) + 0.5) / 200:
        row = np.full(16, offset, np.float32)
        samples, _ = pack(depth, steps, middle, row, order, np.int32(16), capacity=400, most=17)
        valid = np.asarray(samples.valid)
        step = np.floor((np.asarray(samples.t) - 1.5) / 2 * STEPS).astype(int)
        np.add.at(found, (np.asarray(samples.ray)[valid], step[valid]), 1 / 200)
    expected = jit(draw_probability, static_argnums=1)(depth, 16)
    np.testing.assert_allclose(found, expected, atol=3 / 200)  # a grid of 200 offsets


def test_rows_are_read_where_they_are() -> None:
    """Rays in another order, the last of which are none: as if their rows had been gathered first."""
    rng = np.random.default_rng(0)
    depth = np.float32(0.3 * (rng.random((PACKED + 40, STEPS)) < 0.2))
    order = rng.permutation(PACKED + 40)[:PACKED].astype(np.int32)
    (jitter, offset), steps = numbers(PACKED, 2), steps_of(some_rays(PACKED), BOX)
    ours = pack(depth, steps, jitter, offset, order, np.int32(125), capacity=20000, most=64)
    gathered = np.where(np.arange(PACKED)[:, None] < 125, depth[order], 0)
    assert_alike(ours, pack_twin(gathered, steps, jitter, offset, capacity=20000, most=64))


@pytest.mark.parametrize("space", [BOX, BALL, FRUSTUM])
def test_pictures_show_what_is_marched_and_packed(space: Space) -> None:
    rays, grid, most = some_rays(PACKED), some_grid(space, 0.1), 24
    steps, middle = steps_of(rays, space), np.full(PACKED, 0.5, np.float32)
    depth, _ = MARCH(grid, rays, steps, middle, space)

    @jit
    def laid_out(depth: jax.Array) -> list[list[jax.Array]]:
        """Which entries there are, their places and lengths: as they are shown, and as they are packed."""
        shown = kernels.shown_samples(grid, rays, steps, space, max_per_ray=most)
        room = {"capacity": PACKED * most, "max_per_ray": most}
        order, count = jnp.arange(PACKED, dtype=jnp.int32), jnp.int32(PACKED)
        packed, _ = kernels.packed_samples(depth, order, count, steps, jnp.asarray(middle), jnp.asarray(middle), **room)
        return [[one.padded(values) for values in (one.valid * 1.0, one.t, one.length)] for one in (shown, packed)]

    for one, other in zip(*laid_out(depth), strict=True):
        np.testing.assert_array_equal(one, other)


def test_runs_repeat_to_the_bit() -> None:
    rays, grid, (jitter, offset) = some_rays(2048), some_grid(BALL, 0.1), numbers(2048, 2)
    steps, order = steps_of(rays, BALL), np.arange(2048, dtype=np.int32)

    def once() -> list[np.ndarray]:
        depth, hit = MARCH(grid, rays, steps, jitter, BALL)
        packed = pack(depth, steps, jitter, offset, order, np.int32(2048), capacity=8192, most=64)
        return [np.asarray(one) for one in jax.tree.leaves((depth, hit, packed))]

    first = once()
    for _ in range(10):
        for one, other in zip(first, once(), strict=True):
            np.testing.assert_array_equal(one, other)
