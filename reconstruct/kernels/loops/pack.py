"""Rows of samples packed into one list, as a compiled loop; see `reconstruct.sampling.plain.pack`.

Arrays of a call: t (rows, most), length (rows, most), count (rows,). Results: used (rows,), then ray, slot, t, length
and valid (capacity,). One thread does it: it copies less than it would take to ask for help.
"""

import numpy as np

from koala3d.reconstruct.kernels.loops.compiler import compiled, handler
from koala3d.reconstruct.kernels.loops.frame import argument, argument_size, executes, result, result_size

f4 = np.float32


@compiled
def _write_list(frame):
    """One ray after the other into the list, as long as all of a ray's samples find room."""
    rays, most = argument_size(frame, 0, 0), argument_size(frame, 0, 1)
    capacity = result_size(frame, 1, 0)
    own_t, own_length = argument(frame, 0, (rays, most), np.float32), argument(frame, 1, (rays, most), np.float32)
    count, used = argument(frame, 2, (rays,), np.int32), result(frame, 0, (rays,), np.uint8)
    ray_of, slot_of = result(frame, 1, (capacity,), np.int32), result(frame, 2, (capacity,), np.int32)
    t, length = result(frame, 3, (capacity,), np.float32), result(frame, 4, (capacity,), np.float32)
    valid = result(frame, 5, (capacity,), np.uint8)
    end = 0
    for ray in range(rays):
        first, end = end, end + count[ray]
        fits = end <= capacity
        used[ray] = fits and count[ray] > 0
        for entry in range(first, min(end, capacity)):
            ray_of[entry], slot_of[entry], valid[entry] = ray, entry - first, fits
            t[entry] = own_t[ray, entry - first] if fits else f4(1)
            length[entry] = own_length[ray, entry - first] if fits else f4(0)
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
