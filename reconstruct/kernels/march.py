"""What the occupancy grid expects along rays, as a compiled loop; see `reconstruct.sampling.packing.expected_depth`.

Arrays of a call: origins (n, 3), directions (n, 3), cuts (4, n), jitter (n,), depths of the cells in half precision (cells,),
choices (6,): steps in front, inside and behind, cells along an edge of the inner and of the outer grid, and whether what lies
outside the unit ball is contracted. Results: depth (n, steps) and hit (n,), whether any of a ray's is not zero.
"""

import numpy as np

from reconstruct.kernels.along import at, fma, from_half
from reconstruct.kernels.chunks import address_of, in_chunks
from reconstruct.kernels.frame import argument, argument_size, compiled, compiled_exactly, executes, handler, result

RAYS = 64
"""Of a chunk."""
f4, i4 = np.float32, np.int32


@compiled_exactly
def _cell_along(x, half, last):
    """Index along an edge of the cell that holds a coordinate in units of the grid's reach."""
    return i4(min(max(i4((x + f4(1)) * half), i4(0)), last))


@compiled_exactly
def _find_cells(t, first, last, origins, directions, ray, size, outer, contracts, cells):
    """Cells that hold the points of a ray at t from `first` to before `last`."""
    ox, oy, oz = origins[ray, 0], origins[ray, 1], origins[ray, 2]
    dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
    half, end = f4(size * 0.5), i4(size - 1)
    outer_half, outer_end, start = f4(outer * 0.5), i4(outer - 1), i4(size * size * size)
    here = t[first:last]
    for i in range(last - first):
        x, y, z = fma(here[i], dx, ox), fma(here[i], dy, oy), fma(here[i], dz, oz)
        if contracts:
            inverse = f4(1) / np.sqrt(max(fma(z, z, fma(x, x, y * y)), f4(1)))
            shrink = (f4(2) - inverse) * inverse
            x, y, z = x * shrink, y * shrink, z * shrink
        inner = i4(
            i4(i4(_cell_along(x, half, end) * i4(size)) + _cell_along(y, half, end)) * i4(size) + _cell_along(z, half, end)
        )
        if outer > 0 and max(max(abs(x), abs(y)), abs(z)) >= f4(1):
            a = _cell_along(x * f4(0.5), outer_half, outer_end)
            b = _cell_along(y * f4(0.5), outer_half, outer_end)
            c = _cell_along(z * f4(0.5), outer_half, outer_end)
            inner = i4(start + i4(i4(i4(a * i4(outer)) + b) * i4(outer)) + c)
        cells[first + i] = inner


@compiled_exactly
def _march_ray(ray, origins, directions, cuts, jitter, grid, choices, t, cells, depth):
    """Depths along one ray; whether there is any."""
    any_depth, last = False, 0
    for part in range(3):
        first, last = last, last + np.int64(choices[part])
        if not cuts[part + 1, ray] > cuts[part, ray]:  # a ray that misses has no steps inside
            depth[first:last] = f4(0)
            continue
        for step in range(first, last):
            t[step] = at(f4(step) + jitter[ray], cuts, ray, choices)
        _find_cells(t, first, last, origins, directions, ray, choices[3], choices[4], choices[5] != 0, cells)
        for step in range(first, last):
            found = grid[np.uint64(cells[step])]
            depth[step] = from_half(found)
            any_depth |= found != 0
    return any_depth


@compiled
def _march_rays(frame, chunk):
    """The rays of a chunk."""
    count, num_cells = argument_size(frame, 0, 0), argument_size(frame, 4, 0)
    origins, directions = argument(frame, 0, (count, 3), np.float32), argument(frame, 1, (count, 3), np.float32)
    cuts, jitter = argument(frame, 2, (4, count), np.float32), argument(frame, 3, (count,), np.float32)
    grid, choices = argument(frame, 4, (num_cells,), np.uint16), argument(frame, 5, (6,), np.int32)
    steps = choices[0] + choices[1] + choices[2]
    depth, hit = result(frame, 0, (count, steps), np.float32), result(frame, 1, (count,), np.uint8)
    t, cells = np.empty(steps, f4), np.empty(steps, i4)
    for ray in range(chunk * RAYS, min((chunk + 1) * RAYS, count)):
        hit[ray] = _march_ray(ray, origins, directions, cuts, jitter, grid, choices, t, cells, depth[ray])


_address_of_march = address_of(_march_rays, 2)


@handler
def march(frame):
    """Depths of all rays."""
    if executes(frame):
        chunks = (argument_size(frame, 0, 0) + RAYS - 1) // RAYS
        in_chunks(frame, _address_of_march(), chunks, chunks > 1)
    return 0
