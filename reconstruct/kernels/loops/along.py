"""Where on a ray a step coordinate lies, as compiled code; see `reconstruct.sampling.steps.Steps.at`.

Vocabulary: cuts, (4, n): near, enter, leave and far of each ray; counts, (3,): its steps in front, inside and behind.
"""

import numpy as np
from llvmlite import ir
from numba import types

from koala3d.reconstruct.kernels.loops.compiler import compiled, compiled_exactly, intrinsic

f4 = np.float32
LOG2_E = f4(1.4426950408889634)
LOWEST = f4(-126.0)


@intrinsic
def fma(context, a, b, c):
    """a b + c, rounded once."""

    def code(context, builder, signature, arguments):
        return builder.fma(*arguments)

    return types.float32(types.float32, types.float32, types.float32), code


@intrinsic
def rint(context, value):
    """Nearest integer, halves to even, still as a number with a point."""

    def code(context, builder, signature, arguments):
        return builder.call(builder.module.declare_intrinsic("llvm.rint", [ir.FloatType()]), arguments)

    return types.float32(types.float32), code


@intrinsic
def from_bits(context, bits):
    """The number in single precision whose bits these are."""

    def code(context, builder, signature, arguments):
        return builder.bitcast(arguments[0], ir.FloatType())

    return types.float32(types.int32), code


@intrinsic
def from_half(context, bits):
    """The number whose bits in half precision these are."""

    def code(context, builder, signature, arguments):
        return builder.fpext(builder.bitcast(arguments[0], ir.HalfType()), ir.FloatType())

    return types.float32(types.uint16), code


@compiled
def exp_of_minus(x):
    """exp(-x) for x from 0 to infinity, within 3e-7 of itself; below 1e-38 it ends.

    2^n 2^f with n the nearest integer to -x / log 2 and the Taylor series of 2^f, |f| <= 1/2, whose first missing term is 1e-8.
    """
    y = max(-x * LOG2_E, LOWEST)
    n = rint(y)
    f = (y - n) * f4(0.6931471805599453)
    series = f4(1 / 120) + f * f4(1 / 720) + f * f * f4(1 / 5040)
    series = f4(1) + f * (f4(1) + f * (f4(1 / 2) + f * (f4(1 / 6) + f * (f4(1 / 24) + f * series))))
    return series * from_bits(np.int32((np.int32(n) + np.int32(127)) << np.int32(23)))


@compiled_exactly
def at(u, cuts, ray, counts):
    """t at one step coordinate of a ray."""
    enter, leave, far = cuts[1, ray], cuts[2, ray], cuts[3, ray]
    front, inside, behind = f4(counts[0]), f4(counts[1]), f4(counts[2])
    within = fma(leave - enter, (u - front) / inside, enter)
    if counts[2] == 0:
        return within
    if u < front:
        return fma(enter - cuts[0, ray], u / front, cuts[0, ray])
    if u < front + inside:
        return within
    v = min(max((u - front - inside) / behind, f4(0)), f4(1))
    return f4(1) / ((f4(1) - v) / max(leave, f4(1e-6)) + v / max(far, f4(1e-6)))
