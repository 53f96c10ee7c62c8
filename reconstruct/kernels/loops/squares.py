"""The sum of an array's squares as a compiled loop.

Arrays of a call: the numbers. Results: their sum of squares (), and room for those of the chunks (chunks,).
"""

import numpy as np

from koala3d.reconstruct.kernels.loops.chunks import address_of, in_chunks_of
from koala3d.reconstruct.kernels.loops.compiler import compiled, handler, reordered
from koala3d.reconstruct.kernels.loops.frame import argument, argument_length, executes, result, result_size
from koala3d.reconstruct.kernels.squares import CHUNK

f4 = np.float32


@reordered
def _sum(numbers, count):
    total = f4(0)
    for i in range(count):
        total += numbers[i] * numbers[i]
    return total


@compiled
def _square_chunk(frame, chunk):
    first, size = chunk * CHUNK, argument_length(frame, 0)
    room = result(frame, 1, (result_size(frame, 1, 0),), np.float32)
    room[chunk] = _sum(argument(frame, 0, (size,), np.float32)[first:], min(CHUNK, size - first))


@compiled
def _add_chunks(frame):
    room, total = result(frame, 1, (result_size(frame, 1, 0),), np.float32), f4(0)
    for chunk in range(room.shape[0]):
        total += room[chunk]
    result(frame, 0, (1,), np.float32)[0] = total


_address_of_squares = address_of(_square_chunk, 2)


@handler
def squares(frame):
    """Sum of squares; each chunk's own, then the chunks in their order."""
    if executes(frame):
        in_chunks_of(frame, _address_of_squares(), argument_length(frame, 0), CHUNK)
        _add_chunks(frame)
    return 0
