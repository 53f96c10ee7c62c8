"""An occupancy grid: which cells of the scene hold anything, and packed samples in those alone.

Two nested grids cover the contracted scene: a fine one over the cube [-1, 1]^3 around the object, and, where there are
surroundings, a coarse one over [-2, 2]^3. A ray is cut into steps; the steps whose cell is occupied become samples
(Instant-NGP, Mueller et al. 2022, appendix E; nerfacc, Li et al. 2023), packed without gaps, so that work follows occupied
space.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, UInt8, UInt32

from reconstruct.rays import Rays
from reconstruct.sampling.samples import RaySamples

FRONT, BEHIND = 32, 64
"""Steps between the near plane and the object's ball, and from there to the far plane, where there are surroundings."""


class Occupancy(eqx.Module):
    """State of the grids."""

    density: Float[Array, " cells"]
    """Largest density seen lately in each cell [1 / scene unit]; infinite until it was looked at."""
    occupied: UInt8[Array, " cells"]
    """1 where a step through the cell may matter."""
    bits: UInt32[Array, " words"]
    """`occupied`, a bit per cell: an eighth of the memory to look through."""
    extent: Float[Array, " cells"]
    """Length of a step in the cell [scene unit]."""
    visits: Int[Array, " visited"]
    """Cells that can be occupied at all, in a random order: the update walks through them."""
    cursor: Int[Array, ""]
    grid: int = eqx.field(static=True)
    outer_grid: int = eqx.field(static=True)

    @classmethod
    def create(
        cls, key: PRNGKeyArray, *, grid: int, outer_grid: int, bounded: bool, possible: Bool[np.ndarray, " cells"] | None
    ) -> "Occupancy":
        """All cells occupied, or those that are `possible`: of the inner grid where bounded, else of the outer one."""
        inner, outer = grid**3, 0 if bounded else outer_grid**3
        cells = np.ones(inner + outer, bool)
        if possible is not None and bounded:
            cells[:inner] = possible
        if not bounded:
            cells[:inner] = np.linalg.norm(_centres(grid, 1.0), axis=-1) < 1 + np.sqrt(3) / grid
        extent = np.full(inner + outer, 2 / grid, np.float32)
        if outer:
            radius = np.linalg.norm(_centres(outer_grid, 2.0), axis=-1)
            cells[inner:] = (radius > 1 - 2 * np.sqrt(3) / outer_grid) & (radius < 2)
            if possible is not None:
                cells[inner:] &= possible
            extent[inner:] = 4 / outer_grid / np.square(np.maximum(2 - np.maximum(radius, 1), 0.05))
        visits = np.random.default_rng(np.asarray(jax.random.key_data(key))).permutation(np.flatnonzero(cells))
        density = jnp.where(jnp.asarray(cells), jnp.inf, 0.0)
        occupied = jnp.asarray(cells, jnp.uint8)
        return cls(density, occupied, _as_bits(occupied), jnp.asarray(extent), jnp.asarray(visits, jnp.int32),
                   jnp.zeros((), jnp.int32), grid, outer_grid if outer else 0)  # fmt: skip

    def cell(self, x: Float[Array, "..."], y: Float[Array, "..."], z: Float[Array, "..."]) -> Int[Array, "..."]:
        """Index of the cell that holds a point of the contracted scene; clipped to the grid."""
        inner = _cell(x, y, z, self.grid, 1.0)
        if not self.outer_grid:
            return inner
        inside = jnp.maximum(jnp.maximum(jnp.abs(x), jnp.abs(y)), jnp.abs(z)) < 1
        return jnp.where(inside, inner, self.grid**3 + _cell(x, y, z, self.outer_grid, 2.0))

    def updated(self, density_of, key: PRNGKeyArray, count: int, optical_depth: float) -> "Occupancy":
        """Look at the next `count` cells at a random place inside each, forget a little, and decide anew.

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
        occupied = (depth > jnp.clip(mean / 2, 0.01 * optical_depth, optical_depth)).astype(jnp.uint8)
        cursor = (self.cursor + count) % self.visits.shape[0]
        looked = eqx.tree_at(lambda o: (o.density, o.cursor), self, (density, cursor))
        return looked.with_occupied(occupied)

    def with_occupied(self, occupied: UInt8[Array, " cells"]) -> "Occupancy":
        """The same grids with these cells occupied."""
        return eqx.tree_at(lambda o: (o.occupied, o.bits), self, (occupied, _as_bits(occupied)))

    def holds(self, cells: Int[Array, "..."]) -> UInt32[Array, "..."]:
        """1 for occupied cells, 0 for empty ones."""
        words = self.bits.at[cells >> 5].get(mode="promise_in_bounds")
        return (words >> (cells & 31).astype(jnp.uint32)) & jnp.uint32(1)

    def seen(self, cells: Int[Array, " n"], density: Float[Array, " n"]) -> "Occupancy":
        """Take note of densities that training met anyway."""
        return eqx.tree_at(lambda o: o.density, self, self.density.at[cells].max(density, mode="promise_in_bounds"))

    def _points(self, cells: Int[Array, " n"], offset: Float[Array, "3 n"]) -> Float[Array, "3 n"]:
        outside = cells >= self.grid**3
        size = jnp.where(outside, max(self.outer_grid, 1), self.grid)
        reach = jnp.where(outside, 2.0, 1.0)
        local = jnp.where(outside, cells - self.grid**3, cells)
        position = jnp.stack([local // (size * size), local // size % size, local % size]).astype(jnp.float32)
        return ((position + offset) / size * 2 - 1) * reach


def _as_bits(flags: UInt8[Array, "*rows n"] | UInt32[Array, "*rows n"]) -> UInt32[Array, "*rows words"]:
    """Zeros and ones as bits, 32 to a word, the first the lowest; the last word is filled with zeros."""
    padded = jnp.pad(flags, [(0, 0)] * (flags.ndim - 1) + [(0, -flags.shape[-1] % 32)]).astype(jnp.uint32)
    words = padded.reshape(*flags.shape[:-1], -1, 32) << jnp.arange(32, dtype=jnp.uint32)
    return jnp.sum(words, -1, dtype=jnp.uint32)


def _cell(x, y, z, size: int, reach: float):
    i, j, k = (jnp.clip(((v / reach + 1) * (size / 2)).astype(jnp.int32), 0, size - 1) for v in (x, y, z))
    return (i * size + j) * size + k


def _centres(size: int, reach: float) -> Float[np.ndarray, "cells 3"]:
    axis = ((np.arange(size) + 0.5) / size * 2 - 1) * reach
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)


class Steps(eqx.Module):
    """How rays are cut into steps: `at(u)` gives t at step coordinate u in [0, count], per ray monotonic."""

    near: Float[Array, " n"]
    enter: Float[Array, " n"]
    leave: Float[Array, " n"]
    far: Float[Array, " n"]
    front: int = eqx.field(static=True)
    inside: int = eqx.field(static=True)
    behind: int = eqx.field(static=True)

    @classmethod
    def of(cls, rays: Rays, *, steps: int, bounded: bool, near: float, far: float) -> "Steps":
        """Even steps through the object's cube (bounded) or unit ball; front and background around them otherwise."""
        if bounded:
            enter, leave = _cube_interval(rays)
            enter = jnp.maximum(enter, near)
            leave = jnp.maximum(leave, enter)
            return cls(enter, enter, leave, leave, 0, steps, 0)
        along = jnp.sum(rays.directions**2, -1)
        closest = -jnp.sum(rays.origins * rays.directions, -1) / along
        half = 1 - jnp.sum((rays.origins + closest[:, None] * rays.directions) ** 2, -1)
        half = jnp.sqrt(jnp.maximum(half, 0.0) / along)
        enter = jnp.clip(closest - half, near, far)
        leave = jnp.clip(closest + half, enter, far)
        full = jnp.full_like(enter, near)
        return cls(full, enter, leave, jnp.maximum(jnp.full_like(enter, far), leave), FRONT, steps, BEHIND)

    @property
    def count(self) -> int:
        """Steps per ray."""
        return self.front + self.inside + self.behind

    def at(self, u: Float[Array, "n ..."], ray: Int[Array, "..."] | None = None) -> Float[Array, "n ..."]:
        """t at step coordinate u; one row of u per ray, or with `ray` one entry of u per given ray."""
        if ray is None:
            near, enter, leave, far = (v[:, None] for v in (self.near, self.enter, self.leave, self.far))
        else:
            near, enter, leave, far = (
                v.at[ray].get(mode="promise_in_bounds") for v in (self.near, self.enter, self.leave, self.far)
            )
        within = enter + (leave - enter) * ((u - self.front) / self.inside)
        if not self.front:
            return within
        before = near + (enter - near) * (u / self.front)
        v = jnp.clip((u - self.front - self.inside) / self.behind, 0, 1)
        beyond = 1 / ((1 - v) / jnp.maximum(leave, 1e-6) + v / jnp.maximum(far, 1e-6))  # even in disparity
        return jnp.where(u < self.front, before, jnp.where(u < self.front + self.inside, within, beyond))


def _cube_interval(rays: Rays) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Where rays enter and leave the cube [-1, 1]^3; an empty interval where they miss it."""
    direction = jnp.where(jnp.abs(rays.directions) < 1e-9, 1e-9, rays.directions)
    first, second = (-1 - rays.origins) / direction, (1 - rays.origins) / direction
    return jnp.max(jnp.minimum(first, second), -1), jnp.min(jnp.maximum(first, second), -1)


def occupied_steps(
    occupancy: Occupancy, rays: Rays, steps: Steps, jitter: Float[Array, " n"], bounded: bool
) -> UInt32[Array, "n words"]:
    """One bit per step of each ray: set where the step's sample lies in an occupied cell."""
    t = steps.at(jnp.arange(steps.count, dtype=jnp.float32) + jitter[:, None])
    x, y, z = (rays.origins[:, i, None] + t * rays.directions[:, i, None] for i in range(3))
    if not bounded:
        inverse = jax.lax.rsqrt(jnp.maximum(x * x + y * y + z * z, 1.0))  # `contract`, written out: this loop is hot
        x, y, z = (v * ((2 - inverse) * inverse) for v in (x, y, z))
    hit = occupancy.holds(occupancy.cell(x, y, z))
    counts = (steps.front, steps.inside, steps.behind)
    has_length = (steps.enter > steps.near, steps.leave > steps.enter, steps.far > steps.leave)
    parts = [jnp.broadcast_to(part[:, None], (hit.shape[0], count)) for part, count in zip(has_length, counts, strict=True)]
    hit = jnp.where(jnp.concatenate(parts, -1), hit, jnp.uint32(0))  # a ray that misses has no steps inside
    return _as_bits(hit)


def select_bit(words: UInt32[Array, "n words"], rank: Int[Array, " n"]) -> Int[Array, " n"]:
    """Position of the set bit of given rank (0 is the first) in rows of words; halving by population counts."""
    counts = jax.lax.population_count(words).astype(jnp.int32)
    before = jnp.cumsum(counts, -1) - counts
    word = jnp.sum((rank[:, None] >= before + counts).astype(jnp.int32), -1)
    word = jnp.minimum(word, words.shape[-1] - 1)
    rest = rank - jnp.take_along_axis(before, word[:, None], -1)[:, 0]
    bits = jnp.take_along_axis(words, word[:, None], -1)[:, 0]
    position = jnp.zeros_like(rank)
    for width in (16, 8, 4, 2, 1):
        low = jax.lax.population_count(bits & jnp.uint32((1 << width) - 1)).astype(jnp.int32)
        beyond = rest >= low
        rest = jnp.where(beyond, rest - low, rest)
        bits = jnp.where(beyond, bits >> jnp.uint32(width), bits)
        position = position + jnp.where(beyond, width, 0)
    return word * 32 + position


def packed_samples(
    words: UInt32[Array, "rays words"], steps: Steps, jitter: Float[Array, " rays"], *, capacity: int, max_per_ray: int
) -> tuple[RaySamples, Bool[Array, " rays"]]:
    """The occupied steps of all rays in one list of `capacity` entries.

    A ray with more than `max_per_ray` occupied steps is thinned evenly, its intervals lengthened accordingly.

    Returns:
        The samples, and which rays found room for all of theirs: the others take no part.
    """
    found = jnp.sum(jax.lax.population_count(words).astype(jnp.int32), -1)
    kept = jnp.minimum(found, max_per_ray)
    end = jnp.cumsum(kept)
    fits = end <= capacity
    entry = jnp.arange(capacity, dtype=jnp.int32)
    ray = jnp.searchsorted(end, entry, side="right").astype(jnp.int32)
    valid = entry < end[-1]
    ray = jnp.minimum(ray, words.shape[0] - 1)
    get = lambda a: a.at[ray].get(mode="promise_in_bounds")  # noqa: E731
    valid = valid & get(fits)
    slot = jnp.clip(entry - (get(end) - get(kept)), 0, max_per_ray - 1)
    thinning = get(found).astype(jnp.float32) / jnp.maximum(get(kept), 1)
    rank = jnp.minimum(((slot + get(jitter)) * thinning).astype(jnp.int32), get(found) - 1)
    step = select_bit(get(words), jnp.maximum(rank, 0)).astype(jnp.float32)
    length = (steps.at(step + 1, ray) - steps.at(step, ray)) * thinning
    t = steps.at(step + get(jitter), ray)
    samples = RaySamples(ray, slot, jnp.where(valid, t, 1.0), jnp.where(valid, length, 0.0), valid, words.shape[0], max_per_ray)
    return samples, fits
