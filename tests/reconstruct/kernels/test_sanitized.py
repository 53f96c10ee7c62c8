"""Addresses and threads. Every index of a kernel is checked against its array, and no two chunks write the same byte.

What an address and a thread sanitizer would look for, on the same Python source compiled with bounds checks: an access outside
an array or a write into the guard zones around the results, a byte that two chunks write, a chunk that reads what another
writes, and a result that depends on the order of the chunks.

To compile all kernels a second time takes a minute. `make test` does so only after their source has changed; note that it
passed by: python tests/reconstruct/kernels/test_sanitized.py --passed
"""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from koala3d.reconstruct.kernels import native

PROGRAM = Path(__file__).with_name("cases.py")
PASSED = Path(__file__).with_name("sanitized.txt")
"""Digest of the sources that passed."""
BROKEN = """
import sys
sys.path.insert(0, {folder!r})
import cases
from koala3d.reconstruct.kernels import native
from koala3d.reconstruct.kernels.loops import compiler, frame
from koala3d.reconstruct.kernels.loops.compiler import compiled
import numpy as np

@compiled
def beyond(address, chunk):
    frame.result(address, 0, (4,), np.float32)[chunk + 3] = 1.0

@compiled
def shared(address, chunk):
    frame.result(address, 0, (4,), np.float32)[0] = 1.0

@compiled
def reading(address, chunk):
    out = frame.result(address, 0, (4,), np.float32)
    out[chunk] = out[1 - chunk] + 1

for work in (beyond, shared, reading):
    try:
        cases.check(cases.Case(work, 2, [np.zeros(1, np.float32)], [((4,), np.float32)]), np.random.default_rng(0))
    except Exception as error:
        print(error)
native.KERNELS["new"] = ("kernel",)
try:
    cases.main(0)
except AssertionError as error:
    print(error)
"""


def digest() -> str:
    """Of the kernels' sources and their cases."""
    sources = [PROGRAM, *sorted(Path(native.__file__).parent.rglob("*.py"))]
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()


pytestmark = [pytest.mark.slow] if PASSED.read_text(encoding="utf-8").strip() == digest() else []


def checked(*command: str) -> list[str]:
    environment = {**os.environ, "NUMBA_BOUNDSCHECK": "1"}
    done = subprocess.run([sys.executable, *command], env=environment, capture_output=True, text=True, timeout=1800, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.splitlines()


@pytest.mark.parametrize("examples", [6, pytest.param(400, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])])
def test_kernels_stay_inside_their_arrays_and_chunks_apart(examples: int) -> None:
    assert f"pack: {examples} calls" in checked(str(PROGRAM), str(examples))


def test_what_is_wrong_is_found() -> None:
    outside, twice, read, missing = checked("-c", BROKEN.format(folder=str(PROGRAM.parent)))
    assert "out of bounds" in outside and twice == "two chunks write the same byte"
    assert read == "a chunk reads a result" and missing == "every kernel has its cases here"


if __name__ == "__main__" and sys.argv[1:] == ["--passed"]:
    PASSED.write_text(digest() + "\n", encoding="utf-8")
