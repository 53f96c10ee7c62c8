"""Numba's decorators, with the options of kernels; for the type checker, which cannot follow what they do, they are anything."""

from typing import Any

import numba
from numba import types
from numba.extending import intrinsic as _intrinsic

_NUMBA: Any = numba

OPTIONS = {"error_model": "numpy", "fastmath": {"contract", "nsz"}}
"""Of the compiler: no exception is raised, products and sums may be joined."""
EXACT = {"error_model": "numpy", "fastmath": False}
"""The same with each operation rounded by itself."""

intrinsic: Any = _intrinsic
"""Decorator: a function that writes instructions of the machine instead of being compiled."""
array_at: Any = _NUMBA.carray
"""The array of given shape and type at a pointer."""
plain: Any = _NUMBA.njit
"""Decorator: a part of a kernel that computes with integers."""


def handler(function: Any) -> Any:
    """Decorator: a compiled kernel, a function of the frame's address that returns zero; kept on disk."""
    return _NUMBA.cfunc(types.int64(types.int64), cache=True, **OPTIONS)(function)


def compiled(function: Any) -> Any:
    """Decorator: a part of a kernel."""
    return _NUMBA.njit(**OPTIONS)(function)


def reordered(function: Any) -> Any:
    """Decorator: a part of a kernel whose sums may be taken in any order, the same for each call."""
    return _NUMBA.njit(error_model="numpy", fastmath={"contract", "nsz", "reassoc"})(function)


def compiled_exactly(function: Any) -> Any:
    """Decorator: a part of a kernel whose operations are rounded one by one, as they are written."""
    return _NUMBA.njit(**EXACT)(function)
