"""Calls of each kernel on memory of our own, worst cases among them; and what a chunk may do to that memory.

A program: `python cases.py EXAMPLES`, with NUMBA_BOUNDSCHECK=1, so that an index outside an array is an error.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from koala3d.reconstruct.kernels import native, network
from koala3d.reconstruct.kernels.loops import descent, frame, lattice, layers, march, pack, rays, sample, squares

GUARD = 4096
"""Bytes around each result that nobody may write."""
POISONS = (0x5A, 0xC3)
Shape = tuple[tuple[int, ...], type]
ODD = np.array([0.0, -0.0, 0.25, 0.5, 1.0, -1.0, 1e-30, 3e5, -3e9, 1e30, np.inf, -np.inf, np.nan], np.float32)


class Call:
    """A call of a kernel as XLA makes it: arguments, and results between guard zones."""

    def __init__(self, arguments: list[np.ndarray], results: list[Shape], poison: int) -> None:
        self.arguments, self.copies, self.poison = arguments, [one.copy() for one in arguments], poison
        sizes = [int(np.prod(shape)) * np.dtype(kind).itemsize for shape, kind in results]
        self.memory = [np.full(size + 2 * GUARD, poison, np.uint8) for size in sizes]
        self.results = [
            memory[GUARD : GUARD + size].view(kind).reshape(shape)
            for memory, size, (shape, kind) in zip(self.memory, sizes, results, strict=True)
        ]
        self.words = np.zeros(frame.CALL_FRAME["size"] // 8 + 1, np.int64)
        self.words[frame.CALL_FRAME["stage"] // 8] = frame.EXECUTE
        self.alive: list[Any] = []
        for place, arrays in (("arguments", self.arguments), ("results", self.results)):
            lists = np.array([self._buffer(one) for one in arrays], np.int64)
            self.alive.append(lists)
            first = frame.CALL_FRAME[place]
            self.words[(first + frame.BUFFERS["count"]) // 8] = len(arrays)
            self.words[(first + frame.BUFFERS["list"]) // 8] = lists.ctypes.data

    def _buffer(self, array: np.ndarray) -> int:
        words, dims = np.zeros(frame.BUFFER["size"] // 8, np.int64), np.array([*array.shape, 0], np.int64)
        words[frame.BUFFER["data"] // 8], words[frame.BUFFER["rank"] // 8] = array.ctypes.data, array.ndim
        words[frame.BUFFER["dims"] // 8] = dims.ctypes.data
        self.alive += [words, dims]
        return words.ctypes.data

    @property
    def address(self) -> int:
        return self.words.ctypes.data

    def bytes_of_results(self) -> list[np.ndarray]:
        return [memory[GUARD:-GUARD].copy() for memory in self.memory]

    def check(self) -> None:
        """Guard zones and arguments are as they were."""
        for memory in self.memory:
            assert (memory[:GUARD] == self.poison).all() and (memory[-GUARD:] == self.poison).all(), "written outside a result"
        for now, before in zip(self.arguments, self.copies, strict=True):
            assert now.tobytes() == before.tobytes(), "an argument was written"


@dataclass(frozen=True)
class Case:
    """One call of a kernel, which is what `work` makes of each chunk and then `last` of all."""

    work: Any
    chunks: int
    arguments: list[np.ndarray]
    results: list[Shape]
    last: Any = None


def odd(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Numbers of which a tenth are hard."""
    plain = rng.uniform(-1.3, 1.3, shape).astype(np.float32)
    return np.where(rng.random(shape) < 0.1, rng.choice(ODD, shape), plain)


def grid_case(rng: np.random.Generator, *, backward: bool, onto: bool = False) -> Case:
    count, levels, features = rng.choice([1, 2, 255, 256, 257, 700]), rng.integers(1, 5), rng.integers(1, 5)
    logs = rng.integers(4, 9, levels)
    sizes = np.stack([logs, np.cumsum([0, *(2 ** logs[:-1])])]).astype(np.int32)
    share = rng.random((levels, rng.choice([1, count])), np.float32)
    place = [odd(rng, 3, count), share, rng.uniform(1, 900, levels).astype(np.float32), sizes]
    shapes = [(features, levels, count), (features, levels, 3, count)][: rng.integers(1, 3)]
    table = (features, int((2**logs).sum()))
    if backward:
        pulled = [odd(rng, *shape) for shape in shapes]
        if onto:
            return Case(lattice._scatter_level_onto, levels, [*place, *pulled, odd(rng, *table)], [(table, np.float32)])
        return Case(lattice._scatter_level, levels, [*place, *pulled], [(table, np.float32)])
    return Case(lattice._encode_level, levels, [*place, odd(rng, *table)], [(shape, np.float32) for shape in shapes])


def descent_case(rng: np.random.Generator) -> Case:
    count = int(rng.choice([1, 7, descent.CHUNK - 1, descent.CHUNK, descent.CHUNK + 1, 3 * descent.CHUNK + 5]))
    shape = (count,) if rng.random() < 0.5 else (1, count)
    numbers = np.array([0.9, 0.99, 0.5, 0.1, 1e-15, 0.01, rng.integers(0, 2)], np.float32)
    given = [odd(rng, *shape) for _ in range(4)]
    chunks = (count + descent.CHUNK - 1) // descent.CHUNK
    return Case(descent._descend_chunk, chunks, [*given, numbers], [(shape, np.float32)] * 3)


def cuts_of(rng: np.random.Generator, count: int) -> np.ndarray:
    """Near, enter, leave and far: in order for most rays."""
    cuts = np.sort(rng.uniform(0, 5, (4, count)).astype(np.float32), 0)
    return np.where(rng.random(count) < 0.2, odd(rng, 4, count), cuts).astype(np.float32)


def sample_case(rng: np.random.Generator) -> Case:
    count, most, kind = int(rng.choice([1, 63, 64, 65, 200])), int(rng.integers(1, 40)), int(rng.integers(0, 3))
    parts = [int(rng.integers(0, 40)), 32, int(rng.integers(0, 40))] if kind == march.CONTRACTED else [0, 64, 0]
    grid, outer = int(rng.integers(1, 9)), int(rng.integers(1, 6)) * (kind == march.CONTRACTED)
    cells = np.where(rng.random(grid**3 + outer**3) < 0.3, 0.5, 0).astype(np.float16).view(np.uint16)
    numbers = [rng.random(count, np.float32), rng.random(count, np.float32), cells]
    choices = np.array([*parts, grid, outer, kind], np.int32)
    enough = np.array([count + 1, count * most + 1], np.int32)
    given = [odd(rng, count, 3), odd(rng, count, 3), cuts_of(rng, count), *numbers, choices, odd(rng, 17), enough]
    results = [((count, most), np.float32), ((count, most), np.float32), ((count,), np.int32)]
    return Case(sample._sample_rays, (count + sample.RAYS - 1) // sample.RAYS, given, results)


def pack_case(rng: np.random.Generator) -> Case:
    count, most, capacity = int(rng.choice([1, 2, 150])), int(rng.integers(1, 40)), int(rng.choice([1, 40, 300, 6000]))
    found = np.where(rng.random(count) < rng.random(), rng.integers(0, most + 1, count), 0).astype(np.int32)
    lists = [((capacity,), kind) for kind in (np.int32, np.int32, np.float32, np.float32, np.uint8)]
    results = [((count,), np.uint8), *lists]
    return Case(lambda frame, _: pack._write_list(frame), 1, [odd(rng, count, most), odd(rng, count, most), found], results)


def network_case(rng: np.random.Generator, *, backward: bool) -> Case:
    count, sensitive = int(rng.choice([1, 63, 64, 65, 511, 512, 513, 1300])), bool(rng.integers(0, 2))
    depth = 1 if sensitive else int(rng.integers(1, 4))
    widths = rng.integers(1, 40, depth + 2)
    sizes = [shape for into, out in pairwise(widths) for shape in ((out, into), (out,))]
    results = [(widths[-1], count), (widths[0], count)][: 1 + sensitive]
    given = [odd(rng, widths[0], count), *(odd(rng, *shape) for shape in sizes)]
    chunks = (count + network.CHUNK - 1) // network.CHUNK
    if not backward:
        return Case(layers._evaluate_chunk, chunks, given, [(shape, np.float32) for shape in results])
    room = (chunks, network.room(widths.tolist()))
    shapes = [(widths[0], count), *sizes, room]
    pulled = [odd(rng, *shape) for shape in results]
    return Case(layers._back_chunk, chunks, [*given, *pulled], [(shape, np.float32) for shape in shapes], layers._join_chunks)


def compositing_case(rng: np.random.Generator, *, backward: bool) -> Case:
    num_rays, slots = int(rng.choice([1, 63, 64, 65, 150])), int(rng.integers(1, 9))
    kept = rng.integers(0, slots + 1, num_rays)
    spare = int(rng.integers(0, 20))
    count = int(kept.sum()) + spare + 1
    ray = np.concatenate([np.repeat(np.arange(num_rays), kept), np.full(spare + 1, num_rays - 1)]).astype(np.int32)
    slot = np.concatenate([*(np.arange(one) for one in kept), np.full(spare + 1, slots - 1)]).astype(np.int32)
    valid = (np.arange(count) < kept.sum()).astype(np.uint8)
    widths = rng.integers(1, 5, rng.integers(0, 4))
    given = [ray, slot, odd(rng, count), valid, odd(rng, count)]
    given += [odd(rng, width, count) for width in widths]
    sums, chunks = (2 + int(widths.sum()), num_rays), (num_rays + rays.RAYS - 1) // rays.RAYS
    results = [(num_rays, slots), sums]
    if not backward:
        return Case(rays._composite_chunk, chunks, given, [(shape, np.float32) for shape in results])
    shapes = [(count,), *((width, count) for width in widths)]
    pulled = [odd(rng, *shape) for shape in results]
    return Case(rays._back_chunk, chunks, [*given, *pulled], [(shape, np.float32) for shape in shapes])


def squares_case(rng: np.random.Generator) -> Case:
    count = int(rng.choice([1, squares.CHUNK, squares.CHUNK + 1, 3 * squares.CHUNK + 5]))
    chunks = (count + squares.CHUNK - 1) // squares.CHUNK
    return Case(
        squares._square_chunk, chunks, [odd(rng, count)], [((1,), np.float32), ((chunks,), np.float32)], squares._add_chunks
    )


CASES: dict[str, Callable[[np.random.Generator], Case]] = {
    "encode": lambda rng: grid_case(rng, backward=False),
    "scatter": lambda rng: grid_case(rng, backward=True),
    "scatter_onto": lambda rng: grid_case(rng, backward=True, onto=True),
    "descend": descent_case,
    "sample": sample_case,
    "pack": pack_case,
    "squares": squares_case,
    "evaluate": lambda rng: network_case(rng, backward=False),
    "evaluate_back": lambda rng: network_case(rng, backward=True),
    "composite": lambda rng: compositing_case(rng, backward=False),
    "composite_back": lambda rng: compositing_case(rng, backward=True),
}
"""By kernel: a call of random sizes."""
ONE_THREAD = {"pack"}
"""Kernels that are one chunk."""


def kernels() -> Iterator[str]:
    """Names of all kernels; `probe` writes nine numbers and has no chunks."""
    return (name for names in native.KERNELS.values() for name in names if name != "probe")


def run(case: Case, order: Any, poison: int, *, last: bool) -> list[np.ndarray]:
    """Bytes of the results after these chunks, one after the other."""
    call = Call(case.arguments, case.results, poison)
    for chunk in order:
        case.work(call.address, int(chunk))
    if last and case.last is not None:
        case.last(call.address)
    call.check()
    return call.bytes_of_results()


def written_by(case: Case, chunk: int) -> list[np.ndarray]:
    """Which bytes a chunk writes when it is alone: those that differ from one of two poisons; it depends on neither."""
    first, second = (run(case, [chunk], poison, last=False) for poison in POISONS)
    written = [(a != POISONS[0]) | (b != POISONS[1]) for a, b in zip(first, second, strict=True)]
    for a, b, where in zip(first, second, written, strict=True):
        assert (a[where] == b[where]).all(), "a chunk reads a result"
    return written


def check(case: Case, rng: np.random.Generator) -> None:
    """No byte belongs to two chunks, and any order of the chunks gives the same bits, those of chunks alone."""
    owners = [np.zeros(int(np.prod(shape)) * np.dtype(kind).itemsize, np.int64) for shape, kind in case.results]
    for chunk in range(case.chunks):
        for owner, written in zip(owners, written_by(case, chunk), strict=True):
            owner += written
    assert all((owner <= 1).all() for owner in owners), "two chunks write the same byte"
    orders = (np.arange(case.chunks), np.arange(case.chunks)[::-1], rng.permutation(case.chunks))
    ways = [run(case, order, POISONS[0], last=True) for order in orders]
    for way in ways[1:]:
        assert all((a == b).all() for a, b in zip(ways[0], way, strict=True)), "the order of chunks changes the result"


def main(examples: int) -> None:
    """All kernels, so many calls of each."""
    assert set(kernels()) == set(CASES), "every kernel has its cases here"
    for name, make in CASES.items():
        chunks = 0
        for seed in range(examples):
            rng = np.random.default_rng(seed)
            case = make(rng)
            chunks = max(chunks, case.chunks)
            try:
                check(case, rng)
            except Exception as error:
                raise AssertionError(f"{name}, seed {seed}: {error}") from error
        assert chunks > 1 or name in ONE_THREAD, f"{name}: no call had several chunks"
        sys.stdout.write(f"{name}: {examples} calls\n")


if __name__ == "__main__":
    main(int(sys.argv[1]))
