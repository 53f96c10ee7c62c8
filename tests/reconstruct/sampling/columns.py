"""Rays along columns of cells, one cell a step, so that a test may choose the depth of each step."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

import equinox as eqx
import jax
import numpy as np

from koala3d.reconstruct.numerics.compiling import jit
from koala3d.reconstruct.sampling.occupancy import Occupancy
from koala3d.reconstruct.sampling.samples import Rows
from koala3d.reconstruct.sampling.steps import Steps
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import BOX
from tests import drawn

NEAREST, LENGTH = 1.5, 2.0
"""t at which the first step begins, and of all steps together."""


@functools.cache
def sample_of(way: ModuleType) -> Callable[..., Rows]:
    """`sample` of plain JAX or of the kernels, compiled by JAX."""
    return jit(way.sample, static_argnames=("space", "max_per_ray"))


@functools.partial(jax.jit, static_argnums=1)
def _steps_of(rays: Rays, steps: int) -> Steps:
    return Steps.of(rays, steps=steps, space=BOX, near=0.05, far=100.0)


@dataclass
class Columns:
    """A grid, and rays through its columns."""

    grid: Occupancy
    rays: Rays

    @classmethod
    def of(cls, depth: np.ndarray, repeats: int = 1) -> "Columns":
        """So many rays for each row of (columns, steps) depths, one after the other."""
        count, size = depth.shape
        grid = drawn.filled(lambda: Occupancy.create(0, grid=size, outer_grid=0, space=BOX, steps=size, possible=None))
        cells = np.zeros((size * size, size), np.float16)
        cells[:count] = depth
        grid = eqx.tree_at(lambda one: one.depth, grid, drawn.array(cells.reshape(-1), np.float16))
        centres = (np.stack(np.divmod(np.arange(count), size), -1) + 0.5) / size * 2 - 1
        origins = np.repeat(np.concatenate([centres, np.full((count, 1), -1 - NEAREST)], -1), repeats, 0)
        directions = np.broadcast_to([0.0, 0.0, 1.0], origins.shape)
        return cls(grid, Rays(*map(drawn.array, (origins, directions, np.full(len(origins), 1e-3)))))

    def sample(self, way: ModuleType, jitter: np.ndarray, offset: np.ndarray, max_per_ray: int) -> Rows:
        """By plain JAX or by the kernel."""
        given = (self.rays, _steps_of(self.rays, self.grid.grid), np.float32(jitter), np.float32(offset))
        return sample_of(way)(self.grid, *given, space=BOX, max_per_ray=max_per_ray)
