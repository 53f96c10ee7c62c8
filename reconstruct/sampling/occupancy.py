"""An occupancy grid: which cells of the scene hold anything, and how much (Instant-NGP, Mueller et al. 2022, appendix E).

Two nested grids cover the contracted scene: a fine one over the cube [-1, 1]^3 around the object, and, where there are
surroundings, a coarse one over [-2, 2]^3.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Float16, Int, PRNGKeyArray

from koala3d.reconstruct.scene.frustum import Frustum
from koala3d.reconstruct.scene.space import Space

UNKNOWN = 0.02
"""Optical depth of a step through a cell in which the field was not evaluated yet."""
FAINTEST, DENSEST = 1e-4, 1.0
"""Bounds of the optical depth of a step through an occupied cell: its largest density says little about its other parts."""


class Occupancy(eqx.Module):
    """State of the grids."""

    density: Float[Array, " cells"]
    """Largest recent density in each cell [1 / scene unit]; infinite until it was evaluated."""
    depth: Float16[Array, " cells"]
    """Optical depth of a step through the cell where it is occupied, zero elsewhere: what sampling goes by."""
    extent: Float[Array, " cells"]
    """Length of a step in the cell [scene unit]."""
    visits: Int[Array, " visited"]
    """Cells that can be occupied at all, in a random order: the update walks through them."""
    cursor: Int[Array, ""]
    grid: int = eqx.field(static=True)
    outer_grid: int = eqx.field(static=True)

    @classmethod
    def create(
        cls,
        seed: int,
        *,
        grid: int,
        outer_grid: int,
        space: Space,
        steps: int,
        possible: Bool[np.ndarray, " cells"] | None,
    ) -> "Occupancy":
        """All cells occupied, or those that are `possible`: of the only grid where there is one, else of the outer one.

        Args:
            seed: of the order in which cells are visited.
            steps: of a ray, where they are even in the map.
        """
        inner, outer = grid**3, 0 if space.single_grid else outer_grid**3
        cells = np.ones(inner + outer, bool)
        if possible is not None and not outer:
            cells[:inner] = possible
        if outer:
            cells[:inner] = np.linalg.norm(cell_centres(grid, 1.0), axis=-1) < 1 + np.sqrt(3) / grid
        extent = np.full(inner + outer, 2 / grid, np.float32)
        if isinstance(space, Frustum):
            extent[:] = space.length_along(cell_centres(grid, 1.0)) * 2 * space.deep / steps
        if outer:
            radius = np.linalg.norm(cell_centres(outer_grid, 2.0), axis=-1)
            cells[inner:] = (radius > 1 - 2 * np.sqrt(3) / outer_grid) & (radius < 2)
            if possible is not None:
                cells[inner:] &= possible
            extent[inner:] = 4 / outer_grid / np.square(np.maximum(2 - np.maximum(radius, 1), 0.05))
        visits = np.random.default_rng(seed).permutation(np.flatnonzero(cells))
        visits = np.resize(visits, len(cells))  # again and again: programs serve scenes of which more or fewer cells are possible
        density = jnp.where(jnp.asarray(cells), jnp.inf, 0.0)
        depth = jnp.where(jnp.asarray(cells), UNKNOWN, 0.0).astype(jnp.float16)
        order, cursor = jnp.asarray(visits, jnp.int32), jnp.zeros((), jnp.int32)
        return cls(density, depth, jnp.asarray(extent), order, cursor, grid, outer_grid if outer else 0)

    def cell(self, x: Float[Array, "..."], y: Float[Array, "..."], z: Float[Array, "..."]) -> Int[Array, "..."]:
        """Index of the cell that holds a point of the contracted scene; clipped to the grid."""
        inner = _cell(x, y, z, self.grid, 1.0)
        if not self.outer_grid:
            return inner
        inside = jnp.maximum(jnp.maximum(jnp.abs(x), jnp.abs(y)), jnp.abs(z)) < 1
        return jnp.where(inside, inner, self.grid**3 + _cell(x, y, z, self.outer_grid, 2.0))

    def updated(self, density_of, key: PRNGKeyArray, count: int, optical_depth: float) -> "Occupancy":
        """Evaluate the next `count` cells at a random place inside each, forget a little, and decide anew.

        Args:
            density_of: (3, n) points of the contracted scene to (n,) densities.
            optical_depth: a cell whose step holds less than this is empty. While the mean cell holds less than
                twice that, half the mean decides instead (down to a hundredth), so that the thin fog of the first
                steps is given time to take its shape.
        """
        count = min(count, self.visits.shape[0])
        order = (self.cursor + jnp.arange(count, dtype=jnp.int32)) % self.visits.shape[0]
        cells = self.visits[order]
        found = density_of(self._points(cells, jax.random.uniform(key, (3, count))))
        before = self.density[cells]
        density = self.density.at[cells].set(jnp.where(jnp.isinf(before), found, jnp.maximum(before * 0.7, found)))
        depth = density * self.extent
        known = jnp.isfinite(depth)
        mean = jnp.sum(jnp.where(known, depth, 0)) / jnp.maximum(jnp.sum(known & (self.density > 0)), 1)
        occupied = depth > jnp.clip(mean / 2, 0.01 * optical_depth, optical_depth)
        cursor = (self.cursor + count) % self.visits.shape[0]
        evaluated = eqx.tree_at(lambda o: (o.density, o.cursor), self, (density, cursor))
        return evaluated.with_occupied(occupied)

    @property
    def occupied(self) -> Bool[Array, " cells"]:
        """Which cells a step may matter in."""
        return self.depth > 0

    def with_occupied(self, occupied: Bool[Array, " cells"]) -> "Occupancy":
        """The same grids with these cells occupied."""
        depth = jnp.where(jnp.isfinite(self.density), jnp.clip(self.density * self.extent, FAINTEST, DENSEST), UNKNOWN)
        return eqx.tree_at(lambda o: o.depth, self, jnp.where(occupied, depth, 0.0).astype(jnp.float16))

    def noted(self, cells: Int[Array, " n"], density: Float[Array, " n"]) -> "Occupancy":
        """The same with the largest densities that training has met."""
        return eqx.tree_at(lambda o: o.density, self, self.density.at[cells].max(density, mode="promise_in_bounds"))

    def _points(self, cells: Int[Array, " n"], offset: Float[Array, "3 n"]) -> Float[Array, "3 n"]:
        outside = cells >= self.grid**3
        size = jnp.where(outside, max(self.outer_grid, 1), self.grid)
        reach = jnp.where(outside, 2.0, 1.0)
        local = jnp.where(outside, cells - self.grid**3, cells)
        position = jnp.stack([local // (size * size), local // size % size, local % size]).astype(jnp.float32)
        return ((position + offset) / size * 2 - 1) * reach


def _cell(x, y, z, size: int, reach: float):
    i, j, k = (jnp.clip(((v / reach + 1) * (size / 2)).astype(jnp.int32), 0, size - 1) for v in (x, y, z))
    return (i * size + j) * size + k


def cell_centres(size: int, reach: float) -> Float[np.ndarray, "cells 3"]:
    """Centres of the size^3 cells of the cube [-reach, reach]^3, in the order of their indices."""
    axis = ((np.arange(size) + 0.5) / size * 2 - 1) * reach
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
