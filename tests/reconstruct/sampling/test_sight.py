"""Samples that light reaches, against a loop over rays in float64."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.numerics.volume import SPENT, SURFACE
from koala3d.reconstruct.sampling.samples import Rows
from koala3d.reconstruct.sampling.sight import ROOM, in_sight
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import BOX
from tests import drawn

RAYS, SLOTS = 200, 24


def along(density: np.ndarray) -> Callable[[Cloud], jax.Array]:
    """A (rays, slots) density along x: rays of these tests run that way, one beside the other in y."""
    table = drawn.array(density)

    def nearest(cloud: Cloud) -> jax.Array:
        slot, ray = (jnp.round(cloud.points[axis]).astype(jnp.int32) for axis in (0, 1))
        return table[ray, slot]

    return nearest


def some_rays() -> Rays:
    """From x = 0, each at a y of its own; directions of length 1."""
    origins = np.stack([np.zeros(RAYS), np.arange(RAYS), np.zeros(RAYS)], -1)
    directions = np.broadcast_to([1.0, 0.0, 0.0], (RAYS, 3))
    return Rays(*map(drawn.array, (origins, directions, np.full(RAYS, 1e-3))))


def rows_of(filled: np.ndarray) -> Rows:
    """A sample at each of the first slots of each ray, of length 0.1."""
    there = np.arange(SLOTS) < filled[:, None]
    t, length = np.where(there, np.arange(SLOTS), 1.0), np.where(there, 0.1, 0.0)
    return Rows(drawn.array(t), drawn.array(length), drawn.array(filled, np.int32))


def lit(density: np.ndarray, filled: np.ndarray, *, solid: bool) -> np.ndarray:
    """How many samples of each ray light reaches, by the definition of `optical_depth`."""
    count = np.zeros(RAYS, int)
    for ray in range(RAYS):
        gone, before = 0.0, 0.0
        while count[ray] < filled[ray] and gone < SPENT:
            here = density[ray, count[ray]]
            gone += SURFACE * max(here - before, 0.0) if solid else here * 0.1
            before = here
            count[ray] += 1
    return count


@pytest.mark.parametrize("solid", [True, False], ids=["solid", "fog"])
@pytest.mark.parametrize("opaque_at", [3.0, 12.0], ids=["early", "late"])
def test_rows_end_where_light_does(solid: bool, opaque_at: float) -> None:
    """Whatever the round in which it ends: of rays that end late some find no room and stay as they are."""
    rng = np.random.default_rng(5)
    filled = rng.integers(0, SLOTS + 1, RAYS)
    at = rng.exponential(opaque_at, (RAYS, 1))
    density = np.where(np.arange(SLOTS) < at, rng.exponential(3.0, (RAYS, SLOTS)), rng.uniform(300, 600, (RAYS, SLOTS)))
    expected = lit(density, filled, solid=solid)
    found = in_sight(along(density), some_rays(), rows_of(filled), BOX, solid=solid)
    ours = np.asarray(found.filled)
    whole = ours != expected
    np.testing.assert_array_equal(ours[whole], filled[whole])
    assert whole.any() == (opaque_at > 3)
    assert (ours < filled).mean() > 0.2, "much is cut off"


def test_nothing_is_left_out_of_what_is_clear() -> None:
    filled = np.random.default_rng(6).integers(0, SLOTS + 1, RAYS)
    found = in_sight(along(np.full((RAYS, SLOTS), 0.5)), some_rays(), rows_of(filled), BOX, solid=False)
    np.testing.assert_array_equal(found.filled, filled)


def test_rays_without_room_keep_all() -> None:
    """All rays end at their twentieth sample: one of eight is looked at so far, the others stay as they are."""
    density = np.where(np.arange(SLOTS) < 19, 0.0, 1000.0) * np.ones((RAYS, 1))
    found = in_sight(along(density), some_rays(), rows_of(np.full(RAYS, SLOTS)), BOX, solid=True)
    counts = dict(zip(*np.unique(found.filled, return_counts=True), strict=True))
    assert counts == {20: RAYS // ROOM[-1], SLOTS: RAYS - RAYS // ROOM[-1]}
