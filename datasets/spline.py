"""What a lens does beside its formula: a smooth surface of displacements over the image.

The formula of `datasets.camera_model` takes a ray to a place (x', y') in the plane at z = 1. The surface moves that place by

    (dx, dy) = sum over rows i, columns j of  knot[i, j] B((x' - left) / step_x - j) B((y' - top) / step_y - i)

with the uniform cubic B-spline B (de Boor, "A Practical Guide to Splines"; B(0) = 2/3, B(+-1) = 1/6, zero from 2 on). It is twice
continuously differentiable, and zero two steps beyond the outer knots. Displacements are in the units of the plane: times the
focal length they are pixels. So they stay the same when the image is resized or cut. Splined lenses: Kogan, mrcal,
"LENSMODEL_SPLINED_STEREOGRAPHIC", which has no formula beside the spline.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.errors import DatasetError

Points = NDArray[np.float64]
MIN_KNOTS, MAX_KNOTS = 4, 64
"""Fewest and most rows or columns of knots."""
STEEPEST = 0.5
"""Largest slope of a surface, by which a lens is far from folding and Newton's method converges from anywhere."""
_BLOCK = 1 << 14  # places computed at once: they stay in the processor's cache
_RING = 4  # rows and columns of zeros on each side of the knots


@dataclass(frozen=True)
class Grid:
    """Where the knots are, in the plane at z = 1."""

    left: float
    top: float
    step_x: float
    step_y: float
    columns: int
    rows: int

    @property
    def count(self) -> int:
        """Number of knots."""
        return self.rows * self.columns

    @property
    def places(self) -> Points:
        """(rows * columns, 2) places of the knots, row by row."""
        columns, rows = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        places = np.stack([self.left + self.step_x * columns, self.top + self.step_y * rows], -1)
        return places.reshape(-1, 2).astype(np.float64)

    def weights(self, places: Points) -> Points:
        """(n, rows * columns) weight of each knot at (n, 2) places."""
        row, column, across, down, _, _ = self._near(places)
        found = np.zeros((len(places), self.rows + 2 * _RING, self.columns + 2 * _RING))
        every = np.arange(len(places))[:, None, None]
        at = np.arange(4)
        found[every, row[:, None, None] + at[:, None], column[:, None, None] + at] = (down[:, None] * across).transpose(2, 0, 1)
        return found[:, _RING:-_RING, _RING:-_RING].reshape(len(places), -1)

    def surface(self, places: Points, knots: Points) -> tuple[Points, Points]:
        """(n, 2) displacements at (n, 2) places by (rows * columns, 2) knots; and (n, 2, 2) their derivatives by the place."""
        row, column, across, down, by_x, by_y = self._near(places)
        wide = np.pad(knots.reshape(self.rows, self.columns, 2), ((_RING, _RING), (_RING, _RING), (0, 0)))
        value, slope = np.zeros((len(places), 2)), np.zeros((len(places), 2, 2))
        first = row * wide.shape[1] + column
        for axis in range(2):
            flat = np.ascontiguousarray(wide[..., axis]).ravel()
            for i in range(4):
                along, along_by_x = np.zeros(len(places)), np.zeros(len(places))
                for j in range(4):
                    knot = flat[first + (i * wide.shape[1] + j)]
                    along += across[j] * knot
                    along_by_x += by_x[j] * knot
                value[:, axis] += down[i] * along
                slope[:, axis, 0] += down[i] * along_by_x
                slope[:, axis, 1] += by_y[i] * along
        return value, slope

    def _near(self, places: Points) -> tuple[NDArray[np.intp], NDArray[np.intp], Points, Points, Points, Points]:
        """What places see of the grid with a ring of zeros about it.

        (n,) row and column of the first of the 4 x 4 knots that reach each of (n, 2) places; (4, n) their B-splines along x and
        along y; and the derivatives of these by the place.
        """
        found = []
        for axis, (start, step, count) in enumerate(((self.left, self.step_x, self.columns), (self.top, self.step_y, self.rows))):
            along = np.clip((places[:, axis] - start) / step, -2.0, count + 1.0)  # beyond, all knots are zero
            below = np.floor(along)
            values, slopes = _cubic(along - below)
            found.append((below.astype(np.intp) - 1 + _RING, values, slopes / step))
        (column, across, by_x), (row, down, by_y) = found
        return row, column, across, down, by_x, by_y


@dataclass(frozen=True)
class Spline:
    """A surface of displacements. Hashable, as the cameras are that it belongs to."""

    grid: Grid
    knots: tuple[float, ...]
    """dx dy of each knot, row by row, in the plane at z = 1."""

    @cached_property
    def array(self) -> Points:
        """(rows * columns, 2) knots."""
        return np.array(self.knots, np.float64).reshape(-1, 2)

    def bend(self, places: Points) -> Points:
        """(..., 2) places by the lens's formula to (..., 2) places where the lens truly puts them."""
        return _in_blocks(places, lambda some: some + self.grid.surface(some, self.array)[0])

    def straighten(self, bent: Points) -> Points:
        """Inverse of `bend` by Newton's method, to rounding."""
        return _in_blocks(bent, self._newton)

    def _newton(self, bent: Points) -> Points:
        places = bent.copy()
        for _ in range(20):
            moved, slope = self.grid.surface(places, self.array)
            x, y = (places + moved - bent).T
            a, b, c, d = 1 + slope[:, 0, 0], slope[:, 0, 1], slope[:, 1, 0], 1 + slope[:, 1, 1]
            step = np.stack([d * x - b * y, a * y - c * x], -1) / (a * d - b * c)[:, None]
            places = places - step
            if np.abs(step).max(initial=0.0) < 1e-9:  # the next step would be its square
                break
        return places

    @property
    def steepest(self) -> float:
        """Bound on the slope of the surface, by the differences of neighbouring knots; those outside the grid are zero."""
        knots = np.pad(self.array.reshape(self.grid.rows, self.grid.columns, 2), ((1, 1), (1, 1), (0, 0)))
        across = np.abs(np.diff(knots, axis=1)).max() / self.grid.step_x
        down = np.abs(np.diff(knots, axis=0)).max() / self.grid.step_y
        return float(across + down)

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary: where the first knot is, the steps, and rows of columns of (dx, dy)."""
        grid, rows = self.grid, self.array.reshape(self.grid.rows, self.grid.columns, 2)
        return {"first": [grid.left, grid.top], "step": [grid.step_x, grid.step_y], "knots": rows.tolist()}

    @classmethod
    def from_json(cls, content: Any, *, where: object) -> Self:
        """Surface from `to_json`'s dictionary.

        Raises:
            DatasetError: something is missing, unknown, not finite or of another shape, or the surface folds.
        """
        try:
            if set(content) != {"first", "step", "knots"}:
                raise ValueError(f"it has {', '.join(sorted(map(str, content)))} instead of first, step, knots")
            (left, top), (step_x, step_y) = ([float(value) for value in content[name]] for name in ("first", "step"))
            knots = np.array(content["knots"], np.float64)
            if knots.ndim != 3 or knots.shape[2] != 2:
                raise ValueError(f"knots have the shape {knots.shape}, not (rows, columns, 2)")
        except (TypeError, ValueError, KeyError, OverflowError) as error:
            raise DatasetError("spline of the lens is not complete", where=where, why=str(error), remedy=_AGAIN) from None
        rows, columns = knots.shape[:2]
        grid = Grid(left, top, step_x, step_y, columns, rows)
        return cls(grid, tuple(knots.ravel().tolist())).checked(where=where)

    def checked(self, *, where: object) -> Self:
        """This surface if it is possible; else a DatasetError that names what is wrong."""
        grid, why = self.grid, ""
        if not MIN_KNOTS <= min(grid.rows, grid.columns) <= max(grid.rows, grid.columns) <= MAX_KNOTS:
            why = f"{grid.rows} rows of {grid.columns} knots, {MIN_KNOTS} to {MAX_KNOTS} of each are possible"
        elif not np.isfinite([grid.left, grid.top, grid.step_x, grid.step_y, *self.knots]).all():
            why = "a number is not finite"
        elif min(grid.step_x, grid.step_y) <= 0:
            why = f"its steps are {grid.step_x:g} and {grid.step_y:g}"
        elif not self.steepest <= STEEPEST:
            why = f"its slope reaches {self.steepest:.2g}, up to {STEEPEST:g} is possible"
        if why:
            raise DatasetError("spline of the lens is impossible", where=where, why=why, remedy=_AGAIN)
        return self


_AGAIN = "calibrate again"


def _in_blocks(places: Points, change: Callable[[Points], Points]) -> Points:
    """(..., 2) results of `change` for (n, 2) places at a time."""
    flat = places.reshape(-1, 2)
    parts = [change(flat[first : first + _BLOCK]) for first in range(0, len(flat), _BLOCK)]
    return np.concatenate(parts).reshape(places.shape) if parts else places.copy()


def _cubic(share: Points) -> tuple[Points, Points]:
    """(4, n) B-splines of the four knots about places at (n,) shares of the step between the second and third; derivatives."""
    t, rest = share, 1.0 - share
    value = np.stack([rest**3, 3 * t**3 - 6 * t**2 + 4, 3 * rest**3 - 6 * rest**2 + 4, t**3]) / 6
    slope = np.stack([-(rest**2), 3 * t**2 - 4 * t, -3 * rest**2 + 4 * rest, t**2]) / 2
    return value, slope
