"""What the occupancy grid expects along a ray, as a compiled loop; see `reconstruct.sampling.drawing.expected_depth`.

Vocabulary, beside that of `along`: grid, (cells,): depths of the cells in half precision; choices, (6,): steps in front, inside
and behind, cells along an edge of the inner and of the outer grid, and the map: AS_IS, CONTRACTED outside the unit ball, or
STRAIGHTENED; numbers, (17,), of a frustum: rotation, row by row, origin, across, deep, slope, 1 / far and the smallest w.
"""

from math import sqrt

import numpy as np

from koala3d.reconstruct.kernels.loops.along import fma, from_half
from koala3d.reconstruct.kernels.loops.compiler import compiled_exactly

AS_IS, CONTRACTED, STRAIGHTENED = 0, 1, 2
"""Maps: those of `Box`, `Ball` and `Frustum`."""
f4, i4 = np.float32, np.int32


@compiled_exactly
def _find_t(ray, part, first, last, extra, cuts, choices, t):
    """t of the steps from `first` to before `last`, all of one part of the ray; `along.at` without a branch."""
    near, enter, leave, far = cuts[0, ray], cuts[1, ray], cuts[2, ray], cuts[3, ray]
    begin, count = f4(first), f4(choices[part])
    if part < 2:
        start, extent = (near, enter - near) if part == 0 else (enter, leave - enter)
        for i in range(last - first):
            t[i] = fma(extent, ((f4(i) + begin + extra) - begin) / count, start)
    else:
        nearest, furthest, front, inside = max(leave, f4(1e-6)), max(far, f4(1e-6)), f4(choices[0]), f4(choices[1])
        for i in range(last - first):
            v = min(max((f4(i) + begin + extra - front - inside) / count, f4(0)), f4(1))
            t[i] = f4(1) / ((f4(1) - v) / nearest + v / furthest)


@compiled_exactly
def _contract(count, points):
    """The first `count` points in the map of a `Ball`; see `contraction.contract_coordinates`."""
    x, y, z = points[0], points[1], points[2]
    for i in range(count):
        inverse = f4(1) / sqrt(max(fma(z[i], z[i], fma(x[i], x[i], y[i] * y[i])), f4(1)))
        shrink = (f4(2) - inverse) * inverse
        x[i] *= shrink
        y[i] *= shrink
        z[i] *= shrink


@compiled_exactly
def _straighten(count, points, numbers):
    """The first `count` points in the map of a `Frustum`; see its `mapped_coordinates`."""
    x, y, z = points[0], points[1], points[2]
    a, b, c, d, e, f, g, h, k = numbers[:9]
    first, second, third, across, deep, slope, last, smallest = numbers[9:]
    for i in range(count):
        p, q, r = x[i] - first, y[i] - second, z[i] - third
        disparity = f4(1) / max(fma(k, r, fma(h, q, g * p)), smallest)
        share = disparity / across
        x[i] = fma(c, r, fma(b, q, a * p)) * share
        y[i] = fma(f, r, fma(e, q, d * p)) * share
        z[i] = deep - slope * (disparity - last)


@compiled_exactly
def _find_points(t, count, origins, directions, ray, kind, numbers, points):
    """Coordinates in the map of the points of a ray at the first `count` of `t`."""
    for axis in range(3):
        origin, direction, along = origins[ray, axis], directions[ray, axis], points[axis]
        for i in range(count):
            along[i] = fma(t[i], direction, origin)
    if kind == CONTRACTED:
        _contract(count, points)
    elif kind == STRAIGHTENED:
        _straighten(count, points, numbers)


@compiled_exactly
def _cell_of(x, y, z, half, size):
    """Index of the cell that holds a point given in units of the grid's reach; clipped to the grid."""
    i = min(max(i4((x + f4(1)) * half), i4(0)), i4(size - 1))
    j = min(max(i4((y + f4(1)) * half), i4(0)), i4(size - 1))
    k = min(max(i4((z + f4(1)) * half), i4(0)), i4(size - 1))
    return i4(i4(i4(i * size) + j) * size + k)


@compiled_exactly
def _find_cells(points, count, size, outer, cells):
    """Cells that hold the first `count` points; see `Occupancy.cell`."""
    half, outer_half, start = f4(size) * f4(0.5), f4(outer) * f4(0.5), i4(size * size * size)
    x, y, z = points[0], points[1], points[2]
    if outer == 0:
        for i in range(count):
            cells[i] = _cell_of(x[i], y[i], z[i], half, size)
    else:
        for i in range(count):
            inner = _cell_of(x[i], y[i], z[i], half, size)
            beyond = i4(start + _cell_of(x[i] * f4(0.5), y[i] * f4(0.5), z[i] * f4(0.5), outer_half, outer))
            cells[i] = inner if max(max(abs(x[i]), abs(y[i])), abs(z[i])) < f4(1) else beyond


@compiled_exactly
def march_ray(ray, origins, directions, cuts, jitter, grid, choices, numbers, t, points, cells, depth):
    """Write depths along one ray; whether there is any. `jitter`: its own; t, points and cells: room for a ray's steps."""
    any_depth, last = i4(0), 0
    for part in range(3):
        first, last = last, last + np.int64(choices[part])
        count, there = last - first, depth[first:]
        if not cuts[part + 1, ray] > cuts[part, ray]:  # a ray that misses has no steps inside
            for i in range(count):
                there[i] = f4(0)
            continue
        _find_t(ray, part, first, last, jitter, cuts, choices, t)
        _find_points(t, count, origins, directions, ray, choices[5], numbers, points)
        _find_cells(points, count, choices[3], choices[4], cells)
        for i in range(count):
            found = grid[np.uint64(cells[i])]
            any_depth |= i4(found)
            there[i] = from_half(found)
    return any_depth != 0
