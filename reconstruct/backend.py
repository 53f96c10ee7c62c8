"""Settings of JAX that commands make; a library must not impose them."""

import os
from pathlib import Path
from typing import Any


def cache_folder() -> Path:
    """Folder for reproducible files: KOALA_CACHE, or below the user's cache folder."""
    default = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "koala"
    return Path(os.environ.get("KOALA_CACHE") or default)


def cache_compilations() -> None:
    """Keep compiled programs in `cache_folder`, so that the next start is quick."""
    import jax

    jax.config.update("jax_compilation_cache_dir", str(cache_folder() / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


def found() -> dict[str, Any]:
    """What JAX computes on, whether compiled kernels run there, and a line that says so."""
    import jax

    from reconstruct.kernels import native

    devices, why_not = jax.devices(), native.why_not()
    where = f"{len(devices)} x {devices[0].device_kind}" if len(devices) > 1 else devices[0].device_kind
    text = f"{where}: compiled kernels" if why_not is None else f"{where}: plain JAX, for {why_not}"
    if why_not is not None and devices[0].platform == "cpu":
        text += "; a training step takes 1.5 to 2 times as long as with compiled kernels"
    return {
        "platform": devices[0].platform,
        "devices": len(devices),
        "kernels": why_not is None,
        "why_not": why_not,
        "text": text,
    }
