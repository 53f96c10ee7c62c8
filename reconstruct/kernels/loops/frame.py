"""What a compiled kernel sees of a call from XLA: arrays that are read, arrays that are written.

XLA calls a kernel with the address of one structure, `XLA_FFI_CallFrame`; numbers below are offsets of its fields and of those
that it points to [bytes], on machines of 64 bits (`xla/ffi/api/c_api.h`, version 0.3, which comes with jaxlib). `probe` reports
the sizes that the structures really have; `native` refuses to go on with others.

Functions here are compiled by Numba into the kernels that use them. An address is an integer.
"""

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils

from koala3d.reconstruct.kernels.loops.compiler import array_at, handler, intrinsic, plain

CALL_FRAME = {"size": 168, "extension": 8, "api": 16, "context": 24, "stage": 32, "arguments": 40, "results": 80}
BUFFERS = {"size": 40, "count": 16, "list": 32}
BUFFER = {"size": 48, "data": 24, "rank": 32, "dims": 40}
API = {"version": 16, "schedule": 136, "end_of_schedule": 144}
METADATA_EXTENSION, METADATA, MAJOR, MINOR = 1, 24, 24, 28
"""Type of the extension by which XLA asks for a kernel's version, and where the answer goes."""
VERSION = (0, 1)
"""Of the interface that kernels use: none of what came later."""
EXECUTE = 3
"""The stage in which a kernel computes."""

_ARGUMENT_LIST, _RESULT_LIST = CALL_FRAME["arguments"] + BUFFERS["list"], CALL_FRAME["results"] + BUFFERS["list"]
_ARGUMENT_COUNT, _RESULT_COUNT = CALL_FRAME["arguments"] + BUFFERS["count"], CALL_FRAME["results"] + BUFFERS["count"]
_EXTENSION, _STAGE = CALL_FRAME["extension"], CALL_FRAME["stage"]
_DATA, _RANK, _DIMS = BUFFER["data"], BUFFER["rank"], BUFFER["dims"]


@intrinsic
def load_word(context, address):
    """The integer of 64 bits at an address."""

    def code(context, builder, signature, arguments):
        return builder.load(builder.inttoptr(arguments[0], ir.IntType(64).as_pointer()))

    return types.int64(types.int64), code


@intrinsic
def load_half_word(context, address):
    """The integer of 32 bits at an address."""

    def code(context, builder, signature, arguments):
        return builder.load(builder.inttoptr(arguments[0], ir.IntType(32).as_pointer()))

    return types.int32(types.int64), code


@intrinsic
def store_word(context, address, value):
    """Write an integer of 64 bits."""

    def code(context, builder, signature, arguments):
        builder.store(arguments[1], builder.inttoptr(arguments[0], ir.IntType(64).as_pointer()))
        return context.get_dummy_value()

    return types.void(types.int64, types.int64), code


@intrinsic
def store_half_word(context, address, value):
    """Write an integer of 32 bits."""

    def code(context, builder, signature, arguments):
        builder.store(arguments[1], builder.inttoptr(arguments[0], ir.IntType(32).as_pointer()))
        return context.get_dummy_value()

    return types.void(types.int64, types.int32), code


@intrinsic
def _as_pointer(context, address):
    """The address as `array_at` takes it."""

    def code(context, builder, signature, arguments):
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(types.int64), code


@plain
def executes(frame):
    """Whether a kernel has to compute now; where XLA asks for its version, it is answered."""
    extension = load_word(frame + _EXTENSION)
    if extension != 0 and load_half_word(extension + 8) == METADATA_EXTENSION:
        metadata = load_word(extension + METADATA)
        store_half_word(metadata + MAJOR, np.int32(VERSION[0]))
        store_half_word(metadata + MINOR, np.int32(VERSION[1]))
        return False
    return load_half_word(frame + _STAGE) == EXECUTE


@plain
def _argument(frame, index):
    return load_word(load_word(frame + _ARGUMENT_LIST) + 8 * index)


@plain
def _result(frame, index):
    return load_word(load_word(frame + _RESULT_LIST) + 8 * index)


@plain
def argument_count(frame):
    """Number of arguments."""
    return load_word(frame + _ARGUMENT_COUNT)


@plain
def result_count(frame):
    """Number of results."""
    return load_word(frame + _RESULT_COUNT)


@plain
def argument_rank(frame, index):
    """Number of axes of an argument."""
    return load_word(_argument(frame, index) + _RANK)


@plain
def argument_size(frame, index, axis):
    """Length of an argument along an axis."""
    return load_word(load_word(_argument(frame, index) + _DIMS) + 8 * axis)


@plain
def argument_length(frame, index):
    """How many numbers an argument has, along all axes."""
    length = 1
    for axis in range(argument_rank(frame, index)):
        length *= argument_size(frame, index, axis)
    return length


@plain
def result_size(frame, index, axis):
    """Length of a result along an axis."""
    return load_word(load_word(_result(frame, index) + _DIMS) + 8 * axis)


@plain
def argument_address(frame, index):
    """Where an argument's numbers are."""
    return load_word(_argument(frame, index) + _DATA)


@plain
def result_address(frame, index):
    """Where a result's numbers are to be."""
    return load_word(_result(frame, index) + _DATA)


@plain
def argument(frame, index, shape, dtype):
    """An argument as an array of this shape and type, which the caller knows."""
    return array_at(_as_pointer(argument_address(frame, index)), shape, dtype)


@plain
def result(frame, index, shape, dtype):
    """A result as an array to be written."""
    return array_at(_as_pointer(result_address(frame, index)), shape, dtype)


@handler
def probe(frame):
    """Sizes of the structures as XLA has them, the interface's version and the lengths of the argument, as nine integers."""
    if executes(frame):
        found = result(frame, 0, (9,), np.int32)
        api = load_word(frame + 16)
        found[0] = load_word(frame)
        found[1] = load_word(frame + 40)
        found[2] = load_word(frame + 80)
        found[3] = load_word(_argument(frame, 0))
        found[4] = load_word(api)
        found[5] = load_half_word(api + 32)
        found[6] = load_half_word(api + 36)
        found[7] = argument_size(frame, 0, 0)
        found[8] = argument_size(frame, 0, 1)
    return 0
