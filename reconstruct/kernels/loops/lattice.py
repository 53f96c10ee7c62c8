"""The permutohedral lattice as compiled loops: search, hash, read and interpolate, and the way back into the table's gradient.

The same equations as `reconstruct.field.encodings.simplex` and `lattice`, with the same rounding up to the rows and weights: on
machines with fused products both find the same simplex, also where two meet. A level is a chunk. Its points are taken in blocks
that stay in the first-level cache: a search whose loop the compiler vectorises, then reads or additions one row at a time.

Vocabulary: unit, lattice units per unit of a level's points; shift, 32 less the logarithm of its rows; weights, (4, BLOCK)
coefficients of the value; slopes, (3, 4, BLOCK) those of its derivatives; ranks, the four of a point, two bits each.

Arrays of a call, in this order:

    points (3, n), share (levels, n or 1), units (levels,), sizes (2, levels): logarithm of the rows and first row
    and the table (features, rows) or the cotangents of what was computed from it.
"""

import numpy as np
from llvmlite import ir
from numba import types

from koala3d.reconstruct.kernels.loops.along import fma, rint
from koala3d.reconstruct.kernels.loops.chunks import address_of, in_chunks
from koala3d.reconstruct.kernels.loops.compiler import compiled, compiled_exactly, handler, intrinsic
from koala3d.reconstruct.kernels.loops.frame import (
    argument,
    argument_address,
    argument_count,
    argument_size,
    executes,
    result,
    result_address,
    result_count,
    result_size,
)
from koala3d.reconstruct.numerics.lattice_constants import LIFT, MIXER, PRIMES

BLOCK = 256
LINE = 16
"""Numbers in a line of the cache."""
BUSY = 4096
"""Points times levels that are worth a second thread."""
f4, i4, u4 = np.float32, np.int32, np.uint32
A, B, C = (f4(LIFT[0, axis]) for axis in range(3))
TWO_B, THREE_C = f4(LIFT[2, 1]), f4(LIFT[3, 2])
STEP_0, STEP_1, STEP_2 = (u4(4 * prime % 2**32) for prime in PRIMES)
STEP_K = u4(sum(PRIMES) % 2**32)


@intrinsic
def _look_at(context, array, index):
    """Read a number of a vector that nobody uses, so that its line is in the cache; the compiler does not leave it out."""

    def code(context, builder, signature, arguments):
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        place = builder.gep(data, [arguments[1]])
        builder.load_atomic(builder.bitcast(place, ir.IntType(32).as_pointer()), "monotonic", 4)
        return context.get_dummy_value()

    return types.void(array, types.int64), code


@compiled_exactly
def _search(points, first, count, unit, shift, rows, weights, ranks):
    """Rows, weights and ranks of `count` points from `first` on; see `simplex.ordering`, `barycentric`, `lattice.table_rows`."""
    for i in range(count):
        x, y, z = points[0, first + i] * unit, points[1, first + i] * unit, points[2, first + i] * unit
        along_x, along_y = A * x, B * y
        e0 = fma(C, z, fma(A, x, along_y))
        e1 = fma(C, z, fma(B, y, -along_x))
        e2 = fma(C, z, TWO_B * y)
        e3 = THREE_C * z
        r0, r1, r2, r3 = rint(e0), rint(e1), rint(e2), rint(e3)
        d0, d1, d2, d3 = e0 - r0, e1 - r1, e2 - r2, e3 - r3
        n0, n1, n2, n3 = i4(r0), i4(r1), i4(r2), i4(r3)
        excess = i4(n0 + n1 + n2 + n3)
        s01, s02, s03 = i4(d0 < d1), i4(d0 < d2), i4(d0 < d3)
        s12, s13, s23 = i4(d1 < d2), i4(d1 < d3), i4(d2 < d3)
        k0, k1 = i4(s01 + s02 + s03 + excess), i4(i4(1) - s01 + s12 + s13 + excess)
        k2, k3 = i4(i4(2) - s02 - s12 + s23 + excess), i4(i4(3) - s03 - s13 - s23 + excess)
        t0, t1 = i4(i4(k0 < 0) - i4(k0 > 3)), i4(i4(k1 < 0) - i4(k1 > 3))
        t2, t3 = i4(i4(k2 < 0) - i4(k2 > 3)), i4(i4(k3 < 0) - i4(k3 > 3))
        k0, k1, k2, k3 = i4(k0 + i4(4) * t0), i4(k1 + i4(4) * t1), i4(k2 + i4(4) * t2), i4(k3 + i4(4) * t3)
        a, b, c, d = d0 - f4(t0), d1 - f4(t1), d2 - f4(t2), d3 - f4(t3)
        a, b = max(a, b), min(a, b)
        c, d = max(c, d), min(c, d)
        a, c = max(a, c), min(a, c)
        b, d = max(b, d), min(b, d)
        b, c = max(b, c), min(b, c)
        weights[0, i] = f4(1) + d - a
        weights[1, i] = c - d
        weights[2, i] = b - c
        weights[3, i] = a - b
        ranks[i] = i4(k0 | (k1 << i4(2)) | (k2 << i4(4)) | (k3 << i4(6)))
        base = u4(u4(n0 + t0) * STEP_0 + u4(n1 + t1) * STEP_1 + u4(n2 + t2) * STEP_2)
        for k in range(4):
            key = u4(base + u4(k) * STEP_K)
            key = u4(key - (u4(k0 > i4(3 - k)) * STEP_0 + u4(k1 > i4(3 - k)) * STEP_1 + u4(k2 > i4(3 - k)) * STEP_2))
            key = u4((key ^ (key >> u4(15))) * MIXER)
            rows[k, i] = u4(key >> shift)


@compiled
def _find_slopes(ranks, count, unit, slopes):
    """Derivatives of the weights to x, y and z; see `simplex.weight_slopes`."""
    for k in range(4):
        gain, loss = i4(3 - k), i4((4 - k) % 4)
        for i in range(count):
            code = ranks[i]
            r0, r1, r2, r3 = i4(code & 3), i4((code >> 2) & 3), i4((code >> 4) & 3), i4((code >> 6) & 3)
            g0, g1 = f4(r0 == gain) - f4(r0 == loss), f4(r1 == gain) - f4(r1 == loss)
            g2, g3 = f4(r2 == gain) - f4(r2 == loss), f4(r3 == gain) - f4(r3 == loss)
            slopes[0, k, i] = unit * (A * (g0 - g1))
            slopes[1, k, i] = unit * (B * (g0 + g1) + TWO_B * g2)
            slopes[2, k, i] = unit * (C * (g0 + g1 + g2) + THREE_C * g3)


@compiled
def _weigh(coefficients, share, first, count):
    """Four coefficients times the points' share of the level; `share` has one entry or one per point."""
    if share.shape[0] > 1:
        for k in range(4):
            for i in range(count):
                coefficients[k, i] *= share[first + i]
    else:
        for k in range(4):
            for i in range(count):
                coefficients[k, i] *= share[0]


@compiled
def _find(points, share, unit, shift, first, count, with_slopes, rows, weights, slopes, ranks):
    """Rows and all coefficients of a block of points."""
    _search(points, first, count, unit, shift, rows, weights, ranks)
    _weigh(weights, share, first, count)
    if with_slopes:
        _find_slopes(ranks, count, unit, slopes)
        for axis in range(3):
            _weigh(slopes[axis], share, first, count)


@compiled
def _interpolate(vertices, coefficients, count, values):
    """Sum over the vertices of coefficient times value."""
    for i in range(count):
        values[i] = (
            coefficients[0, i] * vertices[0, i]
            + coefficients[1, i] * vertices[1, i]
            + coefficients[2, i] * vertices[2, i]
            + coefficients[3, i] * vertices[3, i]
        )


@compiled
def _scratch():
    """Rows, weights, slopes, ranks and one more array of four numbers for each point of a block."""
    four = np.empty((4, BLOCK), f4)
    return np.empty((4, BLOCK), u4), np.empty((4, BLOCK), f4), np.empty((3, 4, BLOCK), f4), np.empty(BLOCK, i4), four


@compiled
def _common(frame):
    """Points, share, units and sizes of a call."""
    count, levels = argument_size(frame, 0, 1), argument_size(frame, 1, 0)
    points = argument(frame, 0, (3, count), np.float32)
    share = argument(frame, 1, (levels, argument_size(frame, 1, 1)), np.float32)
    return points, share, argument(frame, 2, (levels,), np.float32), argument(frame, 3, (2, levels), np.int32)


@compiled
def _encode_level(frame, level):
    """Values of one level's channels, and with slopes their derivatives."""
    points, share, units, sizes = _common(frame)
    count, levels, features = points.shape[1], units.shape[0], argument_size(frame, 4, 0)
    table = argument(frame, 4, (features, argument_size(frame, 4, 1)), np.float32)
    values = result(frame, 0, (features, levels, count), np.float32)
    with_slopes = result_count(frame) > 1
    first_row, num_rows = sizes[1, level], 1 << sizes[0, level]
    if count * 2 * LINE >= num_rows:  # most lines will be needed: one after the other they come faster
        for feature in range(features):
            for row in range(0, num_rows, LINE):
                _look_at(table[feature], np.int64(first_row + row))
    rows, weights, slopes, ranks, vertices = _scratch()
    for first in range(0, count, BLOCK):
        size = min(BLOCK, count - first)
        shift = u4(32 - sizes[0, level])
        _find(points, share[level], units[level], shift, first, size, with_slopes, rows, weights, slopes, ranks)
        for feature in range(features):
            column = table[feature, first_row:]
            for k in range(4):
                for i in range(size):
                    vertices[k, i] = column[np.uint64(rows[k, i])]
            _interpolate(vertices, weights, size, values[feature, level, first:])
            if with_slopes:
                derivatives = result(frame, 1, (features, levels, 3, count), np.float32)
                for axis in range(3):
                    _interpolate(vertices, slopes[axis], size, derivatives[feature, level, axis, first:])


@compiled
def _scatter_level(frame, level):
    """Gradient of one level's part of the table."""
    sizes, features = _common(frame)[3], argument_size(frame, 4, 0)
    gradient = result(frame, 0, (features, result_size(frame, 0, 1)), np.float32)
    first_row, num_rows = sizes[1, level], 1 << sizes[0, level]
    for feature in range(features):
        column = gradient[feature, first_row:]
        for row in range(num_rows):
            column[row] = f4(0)
    _add_level(frame, level, argument_count(frame) > 5)


@compiled
def _scatter_level_onto(frame, level):
    """The same on top of what is there: the last argument, in whose memory the result is, or of which it is a copy."""
    sizes, features, last = _common(frame)[3], argument_size(frame, 4, 0), argument_count(frame) - 1
    shape = (features, result_size(frame, 0, 1))
    gradient, before = result(frame, 0, shape, np.float32), argument(frame, last, shape, np.float32)
    first_row, num_rows = sizes[1, level], 1 << sizes[0, level]
    if result_address(frame, 0) != argument_address(frame, last):
        for feature in range(features):
            for row in range(first_row, first_row + num_rows):
                gradient[feature, row] = before[feature, row]
    _add_level(frame, level, last > 5)


@compiled
def _add_level(frame, level, with_slopes):
    """Add one level's part of the gradient to the result."""
    points, share, units, sizes = _common(frame)
    count, levels, features = points.shape[1], units.shape[0], argument_size(frame, 4, 0)
    values = argument(frame, 4, (features, levels, count), np.float32)
    gradient, first_row = result(frame, 0, (features, result_size(frame, 0, 1)), np.float32), sizes[1, level]
    rows, weights, slopes, ranks, update = _scratch()
    for first in range(0, count, BLOCK):
        size = min(BLOCK, count - first)
        shift = u4(32 - sizes[0, level])
        _find(points, share[level], units[level], shift, first, size, with_slopes, rows, weights, slopes, ranks)
        for feature in range(features):
            column = gradient[feature, first_row:]
            _spread(values[feature, level, first:], weights, size, update)
            if with_slopes:
                derivatives = argument(frame, 5, (features, levels, 3, count), np.float32)
                for axis in range(3):
                    _spread_more(derivatives[feature, level, axis, first:], slopes[axis], size, update)
            for i in range(size):
                for k in range(4):
                    column[np.uint64(rows[k, i])] += update[k, i]


@compiled
def _spread(cotangent, coefficients, count, update):
    """What each vertex receives from a cotangent."""
    for k in range(4):
        for i in range(count):
            update[k, i] = coefficients[k, i] * cotangent[i]


@compiled
def _spread_more(cotangent, coefficients, count, update):
    """The same, added."""
    for k in range(4):
        for i in range(count):
            update[k, i] += coefficients[k, i] * cotangent[i]


_address_of_encoding, _address_of_scattering = address_of(_encode_level, 2), address_of(_scatter_level, 2)
_address_of_scattering_onto = address_of(_scatter_level_onto, 2)


@handler
def encode(frame):
    """Table to values (features, levels, n) and, where there is a second result, derivatives (features, levels, 3, n)."""
    if executes(frame):
        levels = argument_size(frame, 1, 0)
        in_chunks(frame, _address_of_encoding(), 0, levels, argument_size(frame, 0, 1) * levels >= BUSY)
    return 0


@handler
def scatter(frame):
    """Cotangents of the values, and of the derivatives where they are given, to the gradient of the table (features, rows)."""
    if executes(frame):
        in_chunks(frame, _address_of_scattering(), 0, argument_size(frame, 1, 0), True)
    return 0


@handler
def scatter_onto(frame):
    """The same, added to a gradient (features, rows) that comes last."""
    if executes(frame):
        in_chunks(
            frame,
            _address_of_scattering_onto(),
            0,
            argument_size(frame, 1, 0),
            argument_size(frame, 0, 1) * argument_size(frame, 1, 0) >= BUSY,
        )
    return 0
