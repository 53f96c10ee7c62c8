"""Samples along rays, as a compiled loop: march and draw, one ray after the other; see `reconstruct.sampling.plain.sample`.

Arrays of a call: origins (n, 3), directions (n, 3), cuts (4, n), jitter (n,), offset (n,), grid, choices and numbers of `march`,
and how many rays with samples, and how many samples, are enough (2,): rays after them are not marched.

Results: t (n, most), length (n, most), count (n,): samples of each ray, first in its row; the rest of it has t = 1 and no length.
"""

import numpy as np

from koala3d.reconstruct.kernels.loops.chunks import address_of, in_chunks
from koala3d.reconstruct.kernels.loops.compiler import compiled, handler
from koala3d.reconstruct.kernels.loops.draw import draw_ray
from koala3d.reconstruct.kernels.loops.frame import argument, argument_size, executes, result, result_size
from koala3d.reconstruct.kernels.loops.march import march_ray

RAYS, AT_ONCE = 64, 4
"""Rays of a chunk, and chunks after which it is seen whether there are enough: the same whatever threads there are."""
f4, i4 = np.float32, np.int32


@compiled
def _sample_rays(frame, chunk):
    """The rays of a chunk."""
    count, num_cells, most = argument_size(frame, 0, 0), argument_size(frame, 5, 0), result_size(frame, 0, 1)
    origins, directions = argument(frame, 0, (count, 3), np.float32), argument(frame, 1, (count, 3), np.float32)
    cuts, jitter = argument(frame, 2, (4, count), np.float32), argument(frame, 3, (count,), np.float32)
    offset, grid = argument(frame, 4, (count,), np.float32), argument(frame, 5, (num_cells,), np.uint16)
    choices, numbers = argument(frame, 6, (6,), np.int32), argument(frame, 7, (17,), np.float32)
    t, length = result(frame, 0, (count, most), np.float32), result(frame, 1, (count, most), np.float32)
    drawn, num_steps = result(frame, 2, (count,), np.int32), choices[0] + choices[1] + choices[2]
    along, points, cells = np.empty(num_steps, f4), np.empty((3, num_steps), f4), np.empty(num_steps, i4)
    steps, importance, shares = np.empty(num_steps, i4), np.empty(num_steps, f4), np.empty(num_steps, f4)
    depth = np.empty(num_steps, f4)
    for ray in range(chunk * RAYS, min((chunk + 1) * RAYS, count)):
        found, own = 0, jitter[ray]
        if march_ray(ray, origins, directions, cuts, own, grid, choices, numbers, along, points, cells, depth):
            room = (steps, importance, shares, t[ray], length[ray])
            found = draw_ray(depth, ray, cuts, choices, own, offset[ray], *room)
        drawn[ray] = found
        for slot in range(found, most):
            t[ray, slot], length[ray, slot] = f4(1), f4(0)


_address_of_sampling = address_of(_sample_rays, 2)


@compiled
def _found(drawn, first, end):
    """Rays that have samples from `first` to before `end`, and their samples."""
    rays, samples = 0, 0
    for ray in range(first, end):
        rays += np.int64(drawn[ray] > 0)
        samples += np.int64(drawn[ray])
    return rays, samples


@compiled
def _leave_out(frame, first):
    """Rays from `first` on have no samples."""
    count, most = result_size(frame, 0, 0), result_size(frame, 0, 1)
    t, length = result(frame, 0, (count, most), np.float32), result(frame, 1, (count, most), np.float32)
    drawn = result(frame, 2, (count,), np.int32)
    for ray in range(first, count):
        drawn[ray] = 0
        for slot in range(most):
            t[ray, slot], length[ray, slot] = f4(1), f4(0)


@handler
def sample(frame):
    """Samples of the rays, one group of chunks after the other until there are enough."""
    if executes(frame):
        count, enough = argument_size(frame, 0, 0), argument(frame, 8, (2,), np.int32)
        drawn, chunks = result(frame, 2, (count,), np.int32), (count + RAYS - 1) // RAYS
        first, rays, samples = 0, 0, 0
        while first < chunks and rays < enough[0] and samples < enough[1]:
            end = min(first + AT_ONCE, chunks)
            in_chunks(frame, _address_of_sampling(), first, end, True)
            more = _found(drawn, first * RAYS, min(end * RAYS, count))
            first, rays, samples = end, rays + more[0], samples + more[1]
        _leave_out(frame, min(first * RAYS, count))
    return 0
