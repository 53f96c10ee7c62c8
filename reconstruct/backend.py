"""Settings of JAX that a command wants and a library must not impose."""

import os
from pathlib import Path


def cache_compilations() -> None:
    """Keep compiled programs on disk (KOALA_CACHE, else the user's cache folder), so that the next start is quick."""
    import jax

    default = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "koala"
    folder = Path(os.environ.get("KOALA_CACHE") or default) / "jax"
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
