"""Sums of products of small matrices, C += A B, with C's tiles held in registers.

Rows of B and C are contiguous; A may have any strides, so that it can be read transposed. A tile is four rows of C, of 32 or of
16 columns. What the compiler makes of loops alone writes C to memory at each step of the sum, and takes four times as long.
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils

from koala3d.reconstruct.kernels.loops.compiler import compiled, intrinsic, plain
from koala3d.reconstruct.kernels.network import LANES, ROWS

FLOAT = ir.FloatType()
VECTOR = ir.VectorType(FLOAT, LANES)


def _tile(vectors):
    """C += A B for `ROWS` rows and so many vectors of columns, as instructions of the machine.

    The compiled function takes addresses of A, B and C; A's strides from row to row and from column to column, B's and C's from
    row to row [numbers]; and the length of the sum.
    """

    @intrinsic
    def product(context, a, a_row, a_step, b, b_row, c, c_row, length):

        def code(context, builder, signature, arguments):
            a, a_row, a_step, b, b_row, c, c_row, length = arguments
            constant = ir.Constant(ir.IntType(64), 4)

            def at(address, index, kind):
                return builder.inttoptr(builder.add(address, builder.mul(index, constant)), kind.as_pointer())

            def column(row, vector):
                return builder.add(builder.mul(c_row, ir.IntType(64)(row)), ir.IntType(64)(LANES * vector))

            places = [[at(c, column(row, vector), VECTOR) for vector in range(vectors)] for row in range(ROWS)]
            sums = [[cgutils.alloca_once(builder, VECTOR) for _ in range(vectors)] for _ in range(ROWS)]
            for sum_row, place_row in zip(sums, places, strict=True):
                for one, place in zip(sum_row, place_row, strict=True):
                    builder.store(builder.load(place, align=4), one)
            with cgutils.for_range(builder, length) as loop:
                first = builder.mul(b_row, loop.index)
                lanes = [builder.add(first, ir.IntType(64)(LANES * vector)) for vector in range(vectors)]
                columns = [builder.load(at(b, lane, VECTOR), align=4) for lane in lanes]
                step = builder.mul(a_step, loop.index)
                for row in range(ROWS):
                    place = builder.add(step, builder.mul(a_row, ir.IntType(64)(row)))
                    factor = _everywhere(builder, builder.load(at(a, place, FLOAT)))
                    for vector in range(vectors):
                        old = builder.load(sums[row][vector])
                        builder.store(_fused(builder, factor, columns[vector], old), sums[row][vector])
            for sum_row, place_row in zip(sums, places, strict=True):
                for one, place in zip(sum_row, place_row, strict=True):
                    builder.store(builder.load(one), place, align=4)
            return context.get_dummy_value()

        return types.void(*(types.int64,) * 8), code

    return product


def _everywhere(builder, number):
    """A vector of one number."""
    one = builder.insert_element(ir.Constant(VECTOR, ir.Undefined), number, ir.IntType(32)(0))
    return builder.shuffle_vector(one, ir.Constant(VECTOR, ir.Undefined), ir.Constant(ir.VectorType(ir.IntType(32), LANES), None))


def _fused(builder, factor, other, added):
    """factor other + added, rounded once."""
    kind = ir.FunctionType(VECTOR, [VECTOR] * 3)
    function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.fma.v{LANES}f32")
    return builder.call(function, [factor, other, added])


_wide, _narrow = _tile(2), _tile(1)


@plain
def address(array):
    """Where an array's numbers are."""
    return array.ctypes.data


@compiled
def add_product(a, a_row, a_step, b, b_row, c, c_row, rows, columns, length):
    """C += A B. Arguments are addresses and strides as of a tile; `rows` and `columns` of C, and the length of the sum."""
    for row in range(0, rows, ROWS):
        at_a, at_c = a + 4 * row * a_row, c + 4 * row * c_row
        whole = columns // (2 * LANES) * (2 * LANES)
        for column in range(0, whole, 2 * LANES):
            _wide(at_a, a_row, a_step, b + 4 * column, b_row, at_c + 4 * column, c_row, length)
        if whole < columns:
            _narrow(at_a, a_row, a_step, b + 4 * whole, b_row, at_c + 4 * whole, c_row, length)
