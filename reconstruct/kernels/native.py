"""Whether compiled kernels are used, and calling them.

They run on one CPU device, compiled by Numba at the first use and kept on disk. Everywhere else, and with KOALA_KERNELS=off,
their twins in plain JAX run: on a GPU, on several devices, without Numba, and where XLA has another interface than expected.
"""

import functools
import hashlib
import importlib
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from koala3d.reconstruct.backend import cache_folder

SWITCH = "KOALA_KERNELS"
KERNELS = {
    "frame": ("probe",),
    "lattice": ("encode", "scatter", "scatter_onto"),
    "descent": ("descend",),
    "sample": ("sample",),
    "pack": ("pack",),
    "layers": ("evaluate", "evaluate_back"),
    "squares": ("squares",),
    "rays": ("composite", "composite_back"),
}
"""Compiled functions that XLA calls, by module of `loops`."""
HELPERS = len(os.sched_getaffinity(0)) - 1 if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 2) - 1
"""Threads that a kernel may ask to help the one that XLA calls: compiled into the kernels."""
APART = ("layers", "rays", "squares", "descent")
"""Modules that take half of the time to compile: at the first start another process does that."""


def why_not() -> str | None:
    """Why JAX's own code runs instead, in one line; None where compiled kernels do."""
    if os.environ.get(SWITCH, "") == "off":
        return f"{SWITCH}=off"
    if (platform := jax.default_backend()) != "cpu":
        return f"JAX computes on a {platform}"
    if (count := jax.device_count()) > 1:
        return f"there are {count} devices"
    return _failure()


def usable(*arrays: Any) -> bool:
    """Whether kernels run at all and take arrays of such types: single precision."""
    return all(array.dtype == jnp.float32 for array in arrays) and why_not() is None


def call(
    name: str, results: Sequence[jax.ShapeDtypeStruct], *arguments: Any, in_place: dict[int, int] | None = None
) -> tuple[Array, ...]:
    """Results of a kernel.

    Args:
        results: their shapes and types.
        in_place: index of an argument to index of the result that takes its memory.
    """
    function = jax.ffi.ffi_call(_target(name), tuple(results), vmap_method="sequential", input_output_aliases=in_place)
    return tuple(function(*arguments))


def float32(*shape: int) -> jax.ShapeDtypeStruct:
    """Shape and type of a result in single precision."""
    return jax.ShapeDtypeStruct(shape, jnp.float32)


@functools.cache
def _digest() -> str:
    """Of the kernels' source: programs compiled with other kernels must not be found again."""
    sources = sorted(Path(__file__).parent.rglob("*.py"))
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:12]


def _target(name: str) -> str:
    return f"koala_{name}_{_digest()}"


@functools.cache
def _failure() -> str | None:
    """Compile the kernels and make them known to XLA, once; what went wrong, in one line."""
    try:
        with jax.ensure_compile_time_eval():
            _register(_compiled())
            return _mismatch()
    except ImportError as error:
        return f"Numba cannot be imported: {_first_line(error)}"
    except Exception as error:  # whatever a compiler or another version of XLA says, JAX's own code still runs
        return f"kernels cannot be compiled: {_first_line(error)}"


def _compiled() -> dict[str, Any]:
    """All kernels by name; compiled, or read from the folder of what was compiled before."""
    helper = None if _folder().exists() else _compiling_apart()
    modules = imported([name for name in KERNELS if name not in APART])
    if helper is not None:
        helper.wait()
    modules |= imported(APART)
    return {name: getattr(modules[module], name) for module, names in KERNELS.items() for name in names}


def imported(names: Sequence[str]) -> dict[str, Any]:
    """Modules of `loops`; to import one is to compile it, or to read what was compiled before."""
    from numba.core import config

    options: Any = config
    before = options.CACHE_DIR
    options.CACHE_DIR = str(_folder())  # read while functions are decorated
    try:
        return {name: importlib.import_module(f"koala3d.reconstruct.kernels.loops.{name}") for name in names}
    finally:
        options.CACHE_DIR = before


def _folder() -> Path:
    return cache_folder() / "numba" / f"{_digest()}_{HELPERS}"


def _compiling_apart() -> subprocess.Popen[bytes] | None:
    """A process that compiles `APART`, so that it is read from the disk afterwards; None where there can be none."""
    program = "from koala3d.reconstruct.kernels import native; native.imported(native.APART)"
    try:
        return subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    except OSError:
        return None


def _register(kernels: dict[str, Any]) -> None:
    for name, kernel in kernels.items():
        jax.ffi.register_ffi_target(_target(name), jax.ffi.pycapsule(kernel.ctypes), platform="cpu")


def _mismatch() -> str | None:
    """How XLA's structures differ from those that `frame` describes."""
    from koala3d.reconstruct.kernels.loops import frame

    (found,) = call("probe", [jax.ShapeDtypeStruct((9,), jnp.int32)], np.zeros((3, 5), np.float32))
    call_frame, arguments, results, buffer, api, major, minor, first, second = np.asarray(found).tolist()
    sizes = (call_frame, arguments, results, buffer)
    expected = (frame.CALL_FRAME["size"], frame.BUFFERS["size"], frame.BUFFERS["size"], frame.BUFFER["size"])
    if major != frame.VERSION[0] or sizes != expected or api < frame.API["end_of_schedule"] or (first, second) != (3, 5):
        return f"XLA's interface {major}.{minor} has structures of {sizes} bytes, expected {expected}"
    return None


def _first_line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
