"""Settings of the process that commands make; a library must not impose them."""

import ctypes
import sys

from koala3d.datasets.core.files import cache_folder as cache_folder

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Of mallopt(3)."""
KEPT_BYTES = 1 << 30
"""Freed memory that the process keeps; single arrays of more are given back."""


def configure_process() -> None:
    """Keep compiled programs in `cache_folder`, so that the next start is quick, and freed memory for the next step's arrays."""
    import jax

    jax.config.update("jax_compilation_cache_dir", str(cache_folder() / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    _keep_memory()


def _keep_memory() -> None:
    """Tell glibc not to give freed memory back: the system would clear each page again when the next step asks for it."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, KEPT_BYTES)
        mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
