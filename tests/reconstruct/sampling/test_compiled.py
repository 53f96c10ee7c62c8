"""The kernel that marches and draws against plain JAX, on any grid and in every space."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from koala3d.reconstruct.sampling import compiled, plain
from koala3d.reconstruct.sampling.occupancy import Occupancy
from koala3d.reconstruct.sampling.samples import Rows
from koala3d.reconstruct.sampling.steps import Steps
from koala3d.reconstruct.scene.frustum import Frustum
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import BALL, BOX, Space
from tests import drawn
from tests.reconstruct.sampling.columns import Columns, sample_of

pytestmark = pytest.mark.usefixtures("kernels_run")

STEPS, RAYS = 96, 500
"""Steps of a ray, and rays for which plain JAX is compiled: fewer rays are the first of these."""
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


def rays_apart(ours: Rows, theirs: Rows) -> int:
    """Rays whose samples are not the same."""
    same = np.asarray(ours.filled) == np.asarray(theirs.filled)
    # far away, 1 / t is the small difference of disparities below 20 = 1 / near: 2e-6 of error times t
    for one, other in ((ours.t, theirs.t), (ours.length, theirs.length)):
        same &= np.isclose(one, other, rtol=2e-4, atol=2e-6).all(-1)
    return int((~same).sum())


@pytest.mark.parametrize("space", [BOX, BALL, FRUSTUM])
@pytest.mark.parametrize("share", [0.0, 0.05, 1.0])
def test_the_same_samples_in_every_space(space: Space, share: float) -> None:
    """A point on a cell's face may change its cell, and a sum may round across an integer: in one ray of a hundred."""
    rays, grid = some_rays(RAYS), some_grid(space, share)
    given_all = (rays, steps_of(rays, space), *numbers(RAYS, 2))
    theirs = sample_of(plain)(grid, *given_all, space=space, max_per_ray=24)
    assert (np.asarray(theirs.filled) > 0).any() == (share > 0)
    for count in (1, 63, RAYS):
        first = lambda tree: jax.tree.map(lambda one: np.asarray(one)[:count], tree)  # noqa: B023, E731
        ours = sample_of(compiled)(grid, *first(given_all), space=space, max_per_ray=24)
        assert rays_apart(ours, first(theirs)) <= (count // 100 if share else 0)


@pytest.mark.parametrize("value", [0.0, 1e-4, 1.0, 60.0])
@pytest.mark.parametrize("most", [1, 2, 40])
def test_all_empty_and_all_full(value: float, most: int) -> None:
    columns = Columns.of(np.full((200, STEPS), value, np.float32))
    ours, theirs = (columns.sample(way, *numbers(200, 3), most) for way in (compiled, plain))
    assert rays_apart(ours, theirs) <= 2
    assert np.median(ours.filled) == (most - 1 if value else 0)


@given(st.integers(0, 10000), st.floats(0.01, 1.0), st.sampled_from([2, 64]))
def test_random_depths(seed: int, share: float, most: int) -> None:
    """A running sum may round across an integer: at most in two rays of a hundred."""
    rng = np.random.default_rng(seed)
    columns = Columns.of(rng.choice([0.02, 0.3, 1.0], (200, STEPS)) * (rng.random((200, STEPS)) < share))
    jitter, offset = numbers(200, seed)
    ours, theirs = (columns.sample(way, 0.01 + 0.98 * jitter, offset, most) for way in (compiled, plain))
    assert rays_apart(ours, theirs) <= 4


def test_runs_repeat_to_the_bit() -> None:
    rays, grid = some_rays(2048), some_grid(BALL, 0.1)
    given_all = (rays, steps_of(rays, BALL), *numbers(2048, 2))
    first = sample_of(compiled)(grid, *given_all, space=BALL, max_per_ray=64)
    for _ in range(10):
        for one, other in zip(first, sample_of(compiled)(grid, *given_all, space=BALL, max_per_ray=64), strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("kept", [40, 1000, 2048])
@pytest.mark.parametrize("capacity", [1, 300, 8192, 10**6])
def test_rays_that_are_not_wanted_are_not_marched(kept: int, capacity: int) -> None:
    """The list of the first rays with samples is the same to the bit."""
    rays, grid = some_rays(2048), some_grid(BOX, 0.05)
    given_all = (rays, steps_of(rays, BOX), *numbers(2048, 2))
    everything = sample_of(compiled)(grid, *given_all, space=BOX, max_per_ray=24)
    some = sample_of(compiled)(grid, *given_all, space=BOX, max_per_ray=24, enough=jnp.array([kept, capacity]))
    left_out = (np.asarray(everything.filled) > 0) & (np.asarray(some.filled) == 0)
    assert left_out.any() == (kept < 2048 or capacity < 8192)
    count = min(kept, int(np.count_nonzero(everything.filled)))
    lists = [compiled.pack(rows.first_filled(count)[1], capacity) for rows in (everything, some)]
    (_, there), _ = lists
    valid = np.asarray(there.valid)
    for one, other in zip(*map(jax.tree.leaves, lists), strict=True):
        part = valid if one.shape == valid.shape else slice(None)
        np.testing.assert_array_equal(np.asarray(one)[part], np.asarray(other)[part])
