"""Settings of JAX that commands make; a library must not impose them."""

import os
from pathlib import Path


def cache_folder() -> Path:
    """Folder for reproducible files: KOALA_CACHE, or below the user's cache folder."""
    default = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "koala"
    return Path(os.environ.get("KOALA_CACHE") or default)


def cache_compilations() -> None:
    """Keep compiled programs in `cache_folder`, so that the next start is quick."""
    import jax

    jax.config.update("jax_compilation_cache_dir", str(cache_folder() / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
