"""Rows of samples packed into one list, as a compiled loop; see `reconstruct.sampling.plain.pack`.

Arrays of a call: t (rows, most), length (rows, most), count (rows,). Results: order (rays,), used (rays,), then ray, slot, t,
length and valid (capacity,). One thread does it: it copies less than it would take to ask for help.
"""

import numpy as np

from koala3d.reconstruct.kernels.loops.compiler import compiled, handler
from koala3d.reconstruct.kernels.loops.frame import argument, argument_size, executes, result, result_size

f4 = np.float32


@compiled
def _choose(count, order, chosen):
    """Rows of the rays in the list, and how many samples each has: all of them, or the first that have any and then none."""
    rows, rays = count.shape[0], order.shape[0]
    found = 0
    for row in range(rows):
        if found < rays and (count[row] > 0 or rows == rays):
            order[found], chosen[found] = row, count[row]
            found += 1
    for ray in range(found, rays):
        order[ray], chosen[ray] = 0, 0


@compiled
def _write_list(frame):
    """One ray after the other into the list, as long as all of a ray's samples find room."""
    rows, most = argument_size(frame, 0, 0), argument_size(frame, 0, 1)
    rays, capacity = result_size(frame, 0, 0), result_size(frame, 2, 0)
    own_t, own_length = argument(frame, 0, (rows, most), np.float32), argument(frame, 1, (rows, most), np.float32)
    order, used = result(frame, 0, (rays,), np.int32), result(frame, 1, (rays,), np.uint8)
    ray_of, slot_of = result(frame, 2, (capacity,), np.int32), result(frame, 3, (capacity,), np.int32)
    t, length = result(frame, 4, (capacity,), np.float32), result(frame, 5, (capacity,), np.float32)
    valid, count = result(frame, 6, (capacity,), np.uint8), np.empty(rays, np.int32)
    _choose(argument(frame, 2, (rows,), np.int32), order, count)
    end = 0
    for ray in range(rays):
        first, end, row = end, end + count[ray], order[ray]
        fits = end <= capacity
        used[ray] = fits and count[ray] > 0
        for entry in range(first, min(end, capacity)):
            ray_of[entry], slot_of[entry], valid[entry] = ray, entry - first, fits
            t[entry] = own_t[row, entry - first] if fits else f4(1)
            length[entry] = own_length[row, entry - first] if fits else f4(0)
    first = end - count[rays - 1]
    for entry in range(end, capacity):
        ray_of[entry], slot_of[entry], valid[entry] = rays - 1, min(max(entry - first, 0), most - 1), 0
        t[entry], length[entry] = f4(1), f4(0)


@handler
def pack(frame):
    """The list."""
    if executes(frame):
        _write_list(frame)
    return 0
