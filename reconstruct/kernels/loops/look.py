"""Samples of pictures, as a compiled loop: march, draw and what is drawn, one ray after the other; see `march` and `pack`.

Arrays of a call: origins (n, 3), directions (n, 3), cuts (4, n), depths of the cells in half precision (cells,), choices (8,):
the six of `march`, most samples of a ray, and how many are wanted, and the numbers of `march`. Results: t (n, most),
length (n, most), count (n,): samples of each ray, first in its row; the rest of the row has t = 1 and no length.
"""

import numpy as np

from koala3d.reconstruct.kernels.loops.chunks import address_of, in_chunks_of
from koala3d.reconstruct.kernels.loops.compiler import compiled, handler
from koala3d.reconstruct.kernels.loops.frame import argument, argument_size, executes, result
from koala3d.reconstruct.kernels.loops.march import march_ray
from koala3d.reconstruct.kernels.loops.pack import draw_ray

RAYS = 64
"""Of a chunk."""
MIDDLE = np.float32(0.5)
"""Where in its step a sample is, and where in the sum of probabilities the draw begins: nothing is left to chance."""
f4, i4 = np.float32, np.int32


@compiled
def _look_along(frame, chunk):
    """The rays of a chunk."""
    count, num_cells = argument_size(frame, 0, 0), argument_size(frame, 3, 0)
    origins, directions = argument(frame, 0, (count, 3), np.float32), argument(frame, 1, (count, 3), np.float32)
    cuts, grid = argument(frame, 2, (4, count), np.float32), argument(frame, 3, (num_cells,), np.uint16)
    choices, numbers = argument(frame, 4, (8,), np.int32), argument(frame, 5, (17,), np.float32)
    most, wanted, num_steps = choices[6], f4(choices[7]), choices[0] + choices[1] + choices[2]
    t, length = result(frame, 0, (count, most), np.float32), result(frame, 1, (count, most), np.float32)
    kept = result(frame, 2, (count,), np.int32)
    along, points, cells = np.empty(num_steps, f4), np.empty((3, num_steps), f4), np.empty(num_steps, i4)
    steps, importance, shares = np.empty(num_steps + 1, i4), np.empty(num_steps, f4), np.empty(num_steps, f4)
    depth = np.empty(num_steps, f4)
    for ray in range(chunk * RAYS, min((chunk + 1) * RAYS, count)):
        drawn = 0
        if march_ray(ray, origins, directions, cuts, MIDDLE, grid, choices, numbers, along, points, cells, depth):
            drawn = draw_ray(
                depth, ray, cuts, choices, MIDDLE, MIDDLE, most, wanted, steps, importance, shares, t[ray], length[ray]
            )
        kept[ray] = drawn
        for slot in range(drawn, most):
            t[ray, slot] = f4(1)
            length[ray, slot] = f4(0)


_address_of_look = address_of(_look_along, 2)


@handler
def look(frame):
    """Samples of all rays."""
    if executes(frame):
        in_chunks_of(frame, _address_of_look(), argument_size(frame, 0, 0), RAYS)
    return 0
