"""What nested grids with hashed tables have in common, whatever the shape of their cells."""

from abc import abstractmethod
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from koala3d.reconstruct.field.encodings import tables
from koala3d.reconstruct.field.encodings.encoding import Scale
from koala3d.reconstruct.field.encodings.tables import resolutions_between, start_values
from koala3d.reconstruct.numerics.compiling import barrier


class HashedGrid(eqx.Module):
    """Multi-resolution grid over the cube [-1, 1]^3 (and as far beyond as one likes: rows are hashed)."""

    table: Float[Array, "features rows"]
    """Channels of all levels' tables, one level after the other."""
    blur: Float[Array, ""]
    """Standard deviation that every point has at least; see `Encoding`."""
    resolutions: tuple[float, ...] = eqx.field(static=True)
    """Vertices per unit length of each level, or for other cells than cubes as many per volume as cubes of that spacing."""
    log2_size: int = eqx.field(static=True)
    """Rows of each level, as a power of two."""
    onto: Float[Array, "features rows"] | None = None
    """Gradient of the table so far, see `adding_to`; None: there is none."""

    @classmethod
    def create(
        cls, key: PRNGKeyArray, *, levels: int, features: int, log2_size: int, coarsest: float, finest: float
    ) -> "HashedGrid":
        """Tables of uniform values within 1e-4; resolutions grow geometrically from `coarsest` to `finest`.

        Args:
            log2_size: rows of a level's table, as a power of two.
        """
        resolutions = resolutions_between(coarsest, finest, levels)
        return cls(start_values(key, features, levels, log2_size), jnp.zeros(()), resolutions, log2_size)

    def adding_to(self, gradient: "HashedGrid") -> "HashedGrid":
        """The same grid for one more loss, whose gradient comes out with `gradient` added to it.

        That loss must evaluate the grid exactly once. A gradient of a table is mostly zeros: clearing a second table and adding
        it to the first would take longer than finding the few rows that are not zero.
        """
        return replace(self, onto=jax.lax.stop_gradient(gradient.table))

    @property
    def num_channels(self) -> int:
        """Levels times features."""
        return len(self.resolutions) * self.table.shape[0]

    def __call__(self, points: Float[Array, "3 n"], scale: Scale | None = None) -> Float[Array, "channels n"]:
        """Features of points.

        Args:
            points: coordinates in the grid's space.
            scale: standard deviation of the Gaussian that each point stands for; each level is weighted by
                the share of it that a cell holds. None: points have no extent.
        """
        return self._evaluate(points, scale, with_slopes=False)[0]

    def value_and_jacobian(
        self, points: Float[Array, "3 n"], scale: Scale | None = None
    ) -> tuple[Float[Array, "channels n"], Float[Array, "channels 3 n"]]:
        """Features and their derivative to the position.

        Both differentiable to the tables, neither to the points: where a field is looked at is data. Where the
        share of a level depends on `scale`, that share is held constant.
        """
        value, *slopes = self._evaluate(points, scale, with_slopes=True)
        return value, jnp.stack(slopes, 1)

    @property
    def decay(self) -> float:
        """Slope of the mean square of the table's values, summed over levels (Zip-NeRF, Barron et al. 2023, section 3)."""
        return 2 * len(self.resolutions) / self.table.size

    @abstractmethod
    def located(self, points: Float[Array, "3 n"], scale: Scale | None, *, with_slopes: bool) -> tuple[list, list]:
        """Rows of the vertices around each point and sets of as many coefficients, each (levels, n).

        The first set are the weights of the value; with slopes, their derivatives to x, y and z follow.
        """

    def _evaluate(self, points, scale, *, with_slopes: bool) -> list[Float[Array, "channels n"]]:
        """The value, and with slopes its derivatives to x, y and z."""
        evaluated: Any = _evaluated
        channels = evaluated(self, jax.lax.stop_gradient(points), scale, with_slopes)
        return [jnp.concatenate(one) for one in channels]


def by_row() -> bool:
    """Whether tables are read row by row, and rows and coefficients are found anew on the way back: not on one processor.

    Its caches hold one channel after the other, and it searches more slowly than it reads. Among several devices an index that
    is not flat stays divided.
    """
    return jax.default_backend() != "cpu" or jax.device_count() > 1


def _combined(table: Array, rows: list, coefficients: list) -> list:
    return (tables.combine_rows if by_row() else tables.combine)(table, rows, coefficients)


@partial(jax.custom_vjp, nondiff_argnums=(3,))
def _evaluated(grid: HashedGrid, points: Float[Array, "3 n"], scale: Scale | None, with_slopes: bool) -> list:
    """For value and slopes, each channel's (levels, n); differentiable to the table, everything else is data."""
    return _combined(grid.table, *grid.located(points, scale, with_slopes=with_slopes))


def _forward(grid: HashedGrid, points: Array, scale: Scale | None, with_slopes: bool) -> tuple[list, Any]:
    found = grid.located(points, scale, with_slopes=with_slopes)
    return _combined(grid.table, *found), (grid, points, scale, None if by_row() else found)


def _backward(with_slopes: bool, saved: Any, cotangents: list) -> tuple[Any, ...]:
    grid, points, scale, found = saved
    if found is None:  # without the barrier the compiler would keep what it computed on the way there
        place, cotangents = barrier(((points, scale), cotangents))
        found = grid.located(*place, with_slopes=with_slopes)
    rows, coefficients = found
    gradient = (tables.spread_rows if by_row() else tables.spread)(grid.table.shape, rows, coefficients, cotangents)
    gradient = gradient if grid.onto is None else grid.onto + gradient
    zeros = jax.tree.map(jnp.zeros_like, (grid, points, scale))
    return (eqx.tree_at(lambda one: one.table, zeros[0], gradient), *zeros[1:])


_evaluated.defvjp(_forward, _backward)
