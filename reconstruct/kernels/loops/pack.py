"""Drawing steps and packing them into a list, as a compiled loop; see `draw_probability`, `draw` and `packed_samples` in
`reconstruct.sampling.packing`.

Arrays of a call: depth (rows, steps), order (rays,): row of each ray, chosen (1,): rays that count, the others have no depth,
offset (rays,), jitter (rays,), cuts (4, rays), choices (5,): steps in front, inside and behind, most samples of a ray, and how
many are wanted. Results: ray, slot, t, length, valid (capacity,), fits (rays,), then room for what one ray after the other finds:
kept (rays,), its t and length (rays, most samples).
"""

import numpy as np

from koala3d.reconstruct.kernels.loops.along import at, exp_of_minus
from koala3d.reconstruct.kernels.loops.chunks import address_of, in_chunks_of
from koala3d.reconstruct.kernels.loops.compiler import compiled, compiled_exactly, handler
from koala3d.reconstruct.kernels.loops.frame import argument, argument_size, executes, result, result_size

RAYS = 32
"""Of a chunk."""
LEAST_IMPORTANCE = np.float32(0.02)
"""As in `reconstruct.sampling.packing`."""
TINY, LEAST_SHARE = np.float32(1e-9), np.float32(1e-6)
f4, i4 = np.float32, np.int32


@compiled
def _find_importance(depth, steps, importance):
    """Steps with depth and what each is expected to show; their number."""
    found = 0
    for step in range(depth.shape[0]):
        steps[np.uint64(found)] = step
        found += np.int64(depth[step] > 0)
    before = f4(0)
    for i in range(found):
        importance[i] = before
        before += depth[np.uint64(steps[i])]
    for i in range(found):
        importance[i] = exp_of_minus(importance[i])
    for i in range(found):
        importance[i] = importance[i] * depth[np.uint64(steps[i])] + LEAST_IMPORTANCE
    return found


@compiled
def _factor(importance, found, wanted):
    """From importance to probability, where it stays below one."""
    total = f4(0)
    for i in range(found):
        total += importance[i]
    factor = wanted / max(total, TINY)
    for _ in range(3):  # what is certain already leaves its share to the others
        room, rest = wanted, f4(0)
        for i in range(found):
            certain = importance[i] * factor >= f4(1)
            room -= f4(certain)
            rest += f4(0) if certain else importance[i]
        factor = max(factor, room / max(rest, TINY))
    return factor


@compiled_exactly
def _draw(importance, found, factor, offset, most, steps, shares):
    """Put the drawn steps first in `steps`, their probabilities into `shares`; how many there are, at most `most`."""
    kept, total, passed = 0, f4(0), f4(0)
    for i in range(found):
        share = min(importance[i] * factor, f4(1))
        total += share
        now = np.floor(total + offset)
        if now > passed and kept < most:
            steps[kept] = steps[i]
            shares[kept] = share
            kept += 1
        passed = now
    return kept


@compiled
def draw_ray(depth, ray, cuts, choices, jitter, offset, most, wanted, steps, importance, shares, t, length):
    """Write t and length of the samples that a ray draws; how many there are, at most `most`.

    The rest of the arguments are as in `along.at`, or room for a ray's steps: `steps` with one more, `importance`, `shares`.
    """
    found = _find_importance(depth, steps, importance)
    factor = _factor(importance, found, wanted)
    drawn = _draw(importance, found, factor, offset, most, steps, shares)
    for slot in range(drawn):
        u = f4(steps[slot])
        t[slot] = at(u + jitter, cuts, ray, choices)
        extent = at(u + f4(1), cuts, ray, choices) - at(u, cuts, ray, choices)
        length[slot] = extent / max(shares[slot], LEAST_SHARE)
    return drawn


@compiled
def _pack_rays(frame, chunk):
    """What the rays of a chunk draw."""
    count, num_steps = argument_size(frame, 1, 0), argument_size(frame, 0, 1)
    rows = argument_size(frame, 0, 0)
    depth, order = argument(frame, 0, (rows, num_steps), np.float32), argument(frame, 1, (count,), np.int32)
    chosen, offset = argument(frame, 2, (1,), np.int32), argument(frame, 3, (count,), np.float32)
    jitter, cuts = argument(frame, 4, (count,), np.float32), argument(frame, 5, (4, count), np.float32)
    choices = argument(frame, 6, (5,), np.int32)
    most = choices[3]
    kept, t = result(frame, 6, (count,), np.int32), result(frame, 7, (count, most), np.float32)
    length = result(frame, 8, (count, most), np.float32)
    steps, importance = np.empty(num_steps + 1, i4), np.empty(num_steps, f4)
    shares = np.empty(num_steps, f4)
    for ray in range(chunk * RAYS, min((chunk + 1) * RAYS, count)):
        kept[ray] = 0
        if ray >= chosen[0]:
            continue
        row = depth[np.uint64(order[ray])]
        room = (steps, importance, shares, t[ray], length[ray])
        kept[ray] = draw_ray(row, ray, cuts, choices, jitter[ray], offset[ray], most, f4(choices[4]), *room)


@compiled
def _write_list(frame):
    """One ray after the other into the list, as long as all of a ray's samples find room."""
    count, capacity, most = result_size(frame, 6, 0), result_size(frame, 0, 0), result_size(frame, 7, 1)
    ray_of, slot_of = result(frame, 0, (capacity,), np.int32), result(frame, 1, (capacity,), np.int32)
    t, length = result(frame, 2, (capacity,), np.float32), result(frame, 3, (capacity,), np.float32)
    valid, fits = result(frame, 4, (capacity,), np.uint8), result(frame, 5, (count,), np.uint8)
    kept, own_t = result(frame, 6, (count,), np.int32), result(frame, 7, (count, most), np.float32)
    own_length = result(frame, 8, (count, most), np.float32)
    end = 0
    for ray in range(count):
        first, end = end, end + kept[ray]
        fits[ray] = end <= capacity
        for entry in range(first, min(end, capacity)):
            ray_of[entry], slot_of[entry], valid[entry] = ray, entry - first, fits[ray]
            t[entry] = own_t[ray, entry - first] if fits[ray] else f4(1)
            length[entry] = own_length[ray, entry - first] if fits[ray] else f4(0)
    first = end - kept[count - 1]
    for entry in range(end, capacity):
        ray_of[entry], slot_of[entry], valid[entry] = count - 1, min(max(entry - first, 0), most - 1), 0
        t[entry], length[entry] = f4(1), f4(0)


_address_of_packing = address_of(_pack_rays, 2)


@handler
def pack(frame):
    """Samples of all rays."""
    if executes(frame):
        in_chunks_of(frame, _address_of_packing(), argument_size(frame, 1, 0), RAYS)
        _write_list(frame)
    return 0
