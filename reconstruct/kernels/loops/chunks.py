"""The work of a kernel, cut into chunks that XLA's own threads take one after the other.

What a chunk writes nobody else writes, and how work is cut does not depend on the threads: the result is the same to the bit
whether one thread does all chunks or each its share.

The thread that XLA calls works too. It asks the other threads of XLA's pool for help, goes on, and in the end waits only for
chunks that somebody has begun; so nothing is waited for that may never run. Help that comes late finds nothing left to do.
What the threads share is a block of six integers, which the last of them gives back:

    0   next chunk         8   chunks done       16   threads that hold the block
    24  end of the chunks  32  frame of the call     40   what does a chunk, a function's address
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils

from koala3d.reconstruct.kernels.loops.compiler import intrinsic, plain
from koala3d.reconstruct.kernels.loops.frame import API, CALL_FRAME, load_word, store_word
from koala3d.reconstruct.kernels.native import HELPERS

_API, _CONTEXT, _SCHEDULE = CALL_FRAME["api"], CALL_FRAME["context"], API["schedule"]
_NEXT, _DONE, _HOLDERS, _END, _FRAME, _WORK, _SIZE = 0, 8, 16, 24, 32, 40, 48
WORD = ir.IntType(64)
_REQUEST_SIZE = 40
"""Of XLA_FFI_ThreadPool_Schedule_Args: its size, extensions, the context, the task and what the task is given."""
PATIENCE = 200
"""Looks at the others' progress before the processor is left to somebody else between two looks."""


@intrinsic
def _fetch_add(context, address, value):
    """Add to the integer at an address, in one step as all threads see it; what it was before."""

    def code(context, builder, signature, arguments):
        return builder.atomic_rmw("add", builder.inttoptr(arguments[0], WORD.as_pointer()), arguments[1], "seq_cst")

    return types.int64(types.int64, types.int64), code


@intrinsic
def _allocate(context, size):
    """C's malloc."""

    def code(context, builder, signature, arguments):
        kind = ir.FunctionType(WORD, [WORD])
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, "malloc"), arguments)

    return types.int64(types.int64), code


@intrinsic
def _give_back(context, address):
    """C's free."""

    def code(context, builder, signature, arguments):
        kind = ir.FunctionType(ir.VoidType(), [WORD])
        builder.call(cgutils.get_or_insert_function(builder.module, kind, "free"), arguments)
        return context.get_dummy_value()

    return types.void(types.int64), code


@intrinsic
def _step_aside(context):
    """POSIX's sched_yield."""

    def code(context, builder, signature, arguments):
        kind = ir.FunctionType(ir.IntType(32), [])
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, "sched_yield"), [])

    return types.int32(), code


@intrinsic
def _call(context, function, argument):
    """Call the C function at an address with another address; it returns one."""

    def code(context, builder, signature, arguments):
        kind = ir.FunctionType(WORD, [WORD])
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), [arguments[1]])

    return types.int64(types.int64, types.int64), code


@intrinsic
def _do(context, work, frame, chunk):
    """Call the C function at an address for a chunk."""

    def code(context, builder, signature, arguments):
        kind = ir.FunctionType(ir.VoidType(), [WORD, WORD])
        builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), code


def address_of(work, arguments):
    """What compiled code calls to have the address of a compiled function of integers, as C knows it."""
    kinds = (types.int64,) * arguments

    @intrinsic
    def address(context):
        work.compile(kinds)

        def code(context, builder, signature, nothing):
            compiled = work.overloads[kinds]
            context.active_code_library.add_linking_library(compiled.library)
            kind = ir.FunctionType(ir.VoidType(), [WORD] * arguments)
            function = ir.Function(builder.module, kind, builder.module.get_unique_name("koala_work"))
            function.linkage = "internal"
            inside = ir.IRBuilder(function.append_basic_block())
            callee = context.declare_function(builder.module, compiled.fndesc)
            context.call_conv.call_function(inside, callee, types.void, kinds, function.args)
            inside.ret_void()
            return builder.ptrtoint(function, WORD)

        return types.int64(), code

    return address


@plain
def _take(block):
    """Do chunks as long as there are any."""
    end = load_word(block + _END)
    while True:
        chunk = _fetch_add(block + _NEXT, 1)
        if chunk >= end:
            return
        _do(load_word(block + _WORK), load_word(block + _FRAME), chunk)
        _fetch_add(block + _DONE, 1)


@plain
def _release(block):
    if _fetch_add(block + _HOLDERS, -1) == 1:
        _give_back(block)


@plain
def _help(block):
    _take(block)
    _release(block)


_address_of_help = address_of(_help, 1)


@plain
def _ask_for_help(frame, block):
    """Put `_help` in the queue of XLA's threads; where they refuse, nobody helps."""
    _fetch_add(block + _HOLDERS, 1)
    request = _allocate(_REQUEST_SIZE)
    store_word(request, _REQUEST_SIZE)
    store_word(request + 8, 0)
    store_word(request + 16, load_word(frame + _CONTEXT))
    store_word(request + 24, _address_of_help())
    store_word(request + 32, block)
    refused = _call(load_word(load_word(frame + _API) + _SCHEDULE), request)
    _give_back(request)
    if refused != 0:
        _release(block)


@plain
def in_chunks(frame, work, first, end, worth_help):
    """Call the function at address `work` with the frame and each chunk from `first` to before `end`.

    One thread does it unless several are worth it; then there are as many as processors, and no more than chunks.
    """
    helpers = min(HELPERS, end - first - 1)
    if helpers < 1 or not worth_help:
        for chunk in range(first, end):
            _do(work, frame, chunk)
        return
    block = _allocate(_SIZE)
    store_word(block + _NEXT, first)
    store_word(block + _DONE, first)
    store_word(block + _HOLDERS, 1)
    store_word(block + _END, end)
    store_word(block + _FRAME, frame)
    store_word(block + _WORK, work)
    for _ in range(helpers):
        _ask_for_help(frame, block)
    _take(block)
    looks = 0
    while _fetch_add(block + _DONE, 0) < end:
        looks += 1
        if looks > PATIENCE:
            _step_aside()
    _release(block)


@plain
def in_chunks_of(frame, work, count, size):
    """The same for so many things, `size` of them in a chunk."""
    in_chunks(frame, work, 0, (count + size - 1) // size, True)
