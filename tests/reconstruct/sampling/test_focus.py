"""Rays among surroundings: the grid tells which meet the object, and those are taken sooner."""

import equinox as eqx
import jax
import numpy as np

from koala3d.reconstruct.sampling import focus
from koala3d.reconstruct.sampling.occupancy import Occupancy, cell_centres
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import BALL
from tests import drawn

GRID, HALF_BOX, RADIUS = 32, (0.5, 0.4, 0.6), 0.3
CELL = np.sqrt(3) / GRID
"""Half the diagonal of a cell: a cell whose centre is within the ball may reach so far beyond it."""


def opaque(solid: np.ndarray) -> Occupancy:
    """A grid with opaque matter in the given inner cells, and in all that are around them."""
    fresh = Occupancy.create(0, grid=GRID, outer_grid=8, space=BALL, steps=32, possible=None)
    cells = np.concatenate([solid, np.ones(len(fresh.extent) - len(solid), bool)])
    dense = eqx.tree_at(lambda o: o.density, fresh, drawn.array(np.full(len(cells), 1e3)))
    return jax.jit(Occupancy.with_occupied)(dense, cells)


WEIGHTS = jax.jit(focus.weights)


def weights(occupancy: Occupancy, rays: Rays) -> np.ndarray:
    return np.asarray(WEIGHTS(occupancy, rays, np.float32(HALF_BOX), drawn.uniform(len(rays.radii), seed=1)))


def test_rays_that_meet_the_object_weigh_more(some_rays) -> None:
    rays = some_rays(2000)
    origins, towards = np.asarray(rays.origins, np.float64), np.asarray(rays.directions, np.float64)
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    along = -np.sum(origins * towards, -1)
    beside = np.linalg.norm(origins + along[:, None] * towards, axis=-1)
    found = weights(opaque(np.linalg.norm(cell_centres(GRID, 1.0), axis=-1) < RADIUS), rays)
    longest = 2 * np.linalg.norm(HALF_BOX) / focus.PLACES  # between two places: no chord longer than it is overlooked
    met = (along > 0) & (beside < np.sqrt((RADIUS - CELL) ** 2 - (longest / 2) ** 2))
    missed = (along < 0) | (beside > RADIUS + CELL)
    assert met.sum() > 100 and missed.sum() > 500
    np.testing.assert_allclose(found[missed], focus.BESIDE, atol=1e-7)
    # the grid says an optical depth of 1 a cell, and these chords are longer than a cell by the distance of two places
    assert (found[met] > focus.BESIDE + 1 - np.exp(-1)).all(), found[met].min()


def test_what_the_object_stands_on_does_not_count(some_rays) -> None:
    """Matter around the box, and in the thin layer of it that is left out at each side."""
    outside = (np.abs(cell_centres(GRID, 1.0)) > np.asarray(HALF_BOX) * (1 - focus.INSET) + 1 / GRID).any(-1)
    np.testing.assert_allclose(weights(opaque(outside), some_rays(2000)), focus.BESIDE, atol=1e-7)


def test_entries_are_taken_in_proportion_to_their_weights_and_none_twice() -> None:
    weight, draws = np.float32([1.1, 0.1, 0.1, 1.1, 0.6]), 20_000
    drawing = jax.jit(lambda key, weight: jax.vmap(lambda key: focus.taken(key, weight, 3))(jax.random.split(key, draws)))
    several = np.asarray(drawing(jax.random.key(0), weight))
    assert all(len(set(row)) == 3 for row in several[:200].tolist())
    share, expected = np.bincount(several[:, 0], minlength=5) / draws, weight / weight.sum()
    assert (np.abs(share - expected) < 5 * np.sqrt(expected * (1 - expected) / draws)).all()
    # once the first is taken, the second is drawn from the rest by the same rule
    second = np.bincount(several[several[:, 0] == 0, 1], minlength=5)
    rest = np.where(np.arange(5) > 0, weight, 0) / weight[1:].sum()
    assert (np.abs(second / second.sum() - rest) < 5 * np.sqrt(rest * (1 - rest) / second.sum()) + 1e-12).all()
