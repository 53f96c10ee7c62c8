"""Settings of JAX that commands make; a library must not impose them."""

from koala3d.datasets.core.files import cache_folder as cache_folder


def cache_compilations() -> None:
    """Keep compiled programs in `cache_folder`, so that the next start is quick."""
    import jax

    jax.config.update("jax_compilation_cache_dir", str(cache_folder() / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
