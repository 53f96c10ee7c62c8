"""Emission and absorption along rays as compiled loops; see `reconstruct.kernels.compositing`, `numerics.volume`.

Arrays of a call: ray, slot, t, valid and optical depth (n,) of packed samples, then values (channels, n) each; on the way back
the cotangents of both results, weights (rays, slots) and sums (channels, rays): of weights, of weighted t and of the weighted
values.
"""

import numpy as np

from koala3d.reconstruct.kernels.loops.along import exp_of_minus
from koala3d.reconstruct.kernels.loops.chunks import address_of, in_chunks_of
from koala3d.reconstruct.kernels.loops.compiler import compiled, handler
from koala3d.reconstruct.kernels.loops.frame import (
    argument,
    argument_count,
    argument_size,
    executes,
    result,
    result_count,
    result_size,
)

RAYS = 64
"""Of a chunk."""
FIRST_VALUE = 5
"""Index of the first argument that is composited."""
OPAQUE = np.float32(80.0)
"""As in `reconstruct.numerics.volume`."""
f4 = np.float32


@compiled
def _less_than_one(depth):
    """1 - exp(-depth), also where that is small: up to 3/8 by its series, whose first missing term is 1e-8 of it."""
    if depth > f4(0.375):
        return f4(1) - exp_of_minus(depth)
    series = f4(1 / 120) - depth * (f4(1 / 720) - depth * f4(1 / 5040))
    return depth * (f4(1) - depth * (f4(1 / 2) - depth * (f4(1 / 6) - depth * (f4(1 / 24) - depth * series))))


@compiled
def _first_of(ray, wanted):
    """Index of the first sample whose ray is not before the wanted one; rays ascend."""
    low, high = 0, ray.shape[0]
    while low < high:
        middle = (low + high) // 2
        if ray[middle] < wanted:
            low = middle + 1
        else:
            high = middle
    return low


@compiled
def _bounds(ray, start, stop):
    """First samples of the rays from `start` to before `stop`, and where the last one's end."""
    bounds = np.empty(stop - start + 1, np.int64)
    sample = _first_of(ray, start)
    for one in range(start, stop):
        bounds[one - start] = sample
        while sample < ray.shape[0] and ray[sample] == one:
            sample += 1
    bounds[stop - start] = sample
    return bounds


@compiled
def _samples(frame):
    """Ray, slot, t, valid and optical depth of a call."""
    count = argument_size(frame, 0, 0)
    ray, slot = argument(frame, 0, (count,), np.int32), argument(frame, 1, (count,), np.int32)
    t, valid = argument(frame, 2, (count,), np.float32), argument(frame, 3, (count,), np.uint8)
    return ray, slot, t, valid, argument(frame, 4, (count,), np.float32)


@compiled
def _find_weights(first, end, samples, weights, kept):
    """Weight of each sample from `first` to `end`, all of one chunk's rays, and what is left of the light behind it."""
    ray, _, _, valid, depths = samples
    before, last = f4(0), -1
    for i in range(end - first):
        sample = first + i
        if ray[sample] != last:
            before, last = f4(0), ray[sample]
        depth = f4(0)
        if valid[sample] != 0:
            depth = min(depths[sample], OPAQUE)
        weights[i] = _less_than_one(depth) * exp_of_minus(before)
        before += depth
        kept[i] = exp_of_minus(before)


@compiled
def _composite_chunk(frame, chunk):
    """Weights and sums of a chunk of rays."""
    samples = _samples(frame)
    ray, slot, t, valid, _ = samples
    rays, slots, channels = result_size(frame, 0, 0), result_size(frame, 0, 1), result_size(frame, 1, 0)
    start, stop = chunk * RAYS, min((chunk + 1) * RAYS, rays)
    bounds = _bounds(ray, start, stop)
    first, end = bounds[0], bounds[-1]
    found, kept = np.empty(end - first, f4), np.empty(end - first, f4)
    _find_weights(first, end, samples, found, kept)
    weights, sums = result(frame, 0, (rays, slots), np.float32), result(frame, 1, (channels, rays), np.float32)
    for one in range(start, stop):
        for place in range(slots):
            weights[one, place] = f4(0)
        for channel in range(channels):
            sums[channel, one] = f4(0)
    for i in range(end - first):
        sample = first + i
        if valid[sample] != 0:
            weights[ray[sample], slot[sample]] = found[i]
            sums[0, ray[sample]] += found[i]
            sums[1, ray[sample]] += found[i] * t[sample]
    channel = 2
    for index in range(FIRST_VALUE, argument_count(frame)):
        values = argument(frame, index, (argument_size(frame, index, 0), ray.shape[0]), np.float32)
        for row in range(values.shape[0]):
            own, total = values[row, first:], sums[channel, start:]
            for one in range(stop - start):
                added = f4(0)
                for i in range(bounds[one] - first, bounds[one + 1] - first):
                    added += found[np.uint64(i)] * own[np.uint64(i)]
                total[one] = added
            channel += 1


@compiled
def _back_chunk(frame, chunk):
    """Gradients of a chunk's optical depths and values."""
    samples = _samples(frame)
    ray, slot, t, valid, depths = samples
    count, cotangents = ray.shape[0], argument_count(frame) - 2
    rays, slots = argument_size(frame, cotangents, 0), argument_size(frame, cotangents, 1)
    channels = argument_size(frame, cotangents + 1, 0)
    of_weights = argument(frame, cotangents, (rays, slots), np.float32)
    of_sums = argument(frame, cotangents + 1, (channels, rays), np.float32)
    start, stop = chunk * RAYS, min((chunk + 1) * RAYS, rays)
    bounds = _bounds(ray, start, stop)
    first, end = bounds[0], bounds[-1]
    weights, kept, pull = np.empty(end - first, f4), np.empty(end - first, f4), np.empty(end - first, f4)
    _find_weights(first, end, samples, weights, kept)
    for i in range(end - first):
        sample = first + i
        one = ray[sample]
        pull[i] = of_weights[one, slot[sample]] + of_sums[0, one] + of_sums[1, one] * t[sample]
    channel = 2
    for index in range(1, result_count(frame)):
        rows = result_size(frame, index, 0)
        values = argument(frame, FIRST_VALUE + index - 1, (rows, count), np.float32)
        gradient = result(frame, index, (rows, count), np.float32)
        for row in range(rows):
            own, pulled, found = values[row, first:], of_sums[channel, start:], gradient[row, first:]
            for one in range(stop - start):
                cotangent = pulled[one]
                for i in range(bounds[one] - first, bounds[one + 1] - first):
                    pull[np.uint64(i)] += cotangent * own[np.uint64(i)]
                    found[np.uint64(i)] = weights[np.uint64(i)] * cotangent
            channel += 1
    gradient = result(frame, 0, (count,), np.float32)
    behind, last = f4(0), -1
    for i in range(end - first - 1, -1, -1):
        sample = first + i
        if ray[sample] != last:
            behind, last = f4(0), ray[sample]
        seen = valid[sample] != 0 and depths[sample] < OPAQUE
        gradient[sample] = pull[i] * kept[i] - behind if seen else f4(0)
        if valid[sample] != 0:
            behind += pull[i] * weights[i]


_address_of_compositing, _address_of_back = address_of(_composite_chunk, 2), address_of(_back_chunk, 2)


@handler
def composite(frame):
    """Weights (rays, slots) and sums (channels, rays)."""
    if executes(frame):
        in_chunks_of(frame, _address_of_compositing(), result_size(frame, 0, 0), RAYS)
    return 0


@handler
def composite_back(frame):
    """Gradients of the optical depth (n,) and of the values (channels, n) each."""
    if executes(frame):
        in_chunks_of(frame, _address_of_back(), argument_size(frame, argument_count(frame) - 2, 0), RAYS)
    return 0
