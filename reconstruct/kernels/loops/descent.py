"""One step of Adam as a compiled loop: gradient, both moments and parameter are each read once and written in place.

Arrays of a call: gradient, parameter, mean, square (all of one shape), numbers (8,): the decays of both moments, the corrections
of their bias, the smallest denominator, the rate, one, or zero where the step is to be left out, and what times the parameter is
added to the gradient. Results: parameter, mean, square.
"""

from math import sqrt

import numpy as np

from koala3d.reconstruct.kernels.loops.chunks import address_of, in_chunks_of
from koala3d.reconstruct.kernels.loops.compiler import compiled, handler
from koala3d.reconstruct.kernels.loops.frame import (
    argument,
    argument_address,
    argument_length,
    executes,
    result,
    result_address,
)

CHUNK = 32768
"""Numbers of a chunk: its seven arrays fit into the second-level cache."""
f4 = np.float32


@compiled
def _in_place(frame, index, first, count):
    """Part of a result, with the numbers of the argument whose memory it takes: that of the index after its own."""
    new = result(frame, index, (first + count,), np.float32)[first:]
    if result_address(frame, index) != argument_address(frame, index + 1):
        old = argument(frame, index + 1, (first + count,), np.float32)[first:]
        for i in range(count):
            new[i] = old[i]
    return new


@compiled
def _descend_chunk(frame, chunk):
    first = chunk * CHUNK
    count = min(CHUNK, argument_length(frame, 0) - first)
    numbers = argument(frame, 4, (8,), np.float32)
    gradient = argument(frame, 0, (first + count,), np.float32)[first:]
    parameter, mean = _in_place(frame, 0, first, count), _in_place(frame, 1, first, count)
    square = _in_place(frame, 2, first, count)
    keep_mean, keep_square, smallest, rate, shrinks = numbers[0], numbers[1], numbers[4], numbers[5], numbers[7]
    add_mean, add_square = f4(1) - keep_mean, f4(1) - keep_square
    of_mean, of_square = f4(1) / numbers[2], f4(1) / numbers[3]
    if numbers[6] != 0:
        for i in range(count):
            g = gradient[i] + shrinks * parameter[i]
            m = add_mean * g + keep_mean * mean[i]
            s = add_square * (g * g) + keep_square * square[i]
            mean[i] = m
            square[i] = s
            parameter[i] -= rate * (m * of_mean / (sqrt(s * of_square) + smallest))


_address_of_descent = address_of(_descend_chunk, 2)


@handler
def descend(frame):
    """Parameter and moments after a step."""
    if executes(frame):
        in_chunks_of(frame, _address_of_descent(), argument_length(frame, 0), CHUNK)
    return 0
