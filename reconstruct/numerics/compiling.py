"""What the compiler is told: which stages of a computation stay apart.

The compiler fuses one stage into the loops of the next, and then computes it again in each. A barrier between them stops that.
On the CPU it drops barriers before it fuses, unless it is asked to keep them: the simplex search would run inside each of the
gathers that use it, and a training step take 390 ms instead of 28. Hence `jit` and `compiled` in place of JAX's own.
"""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax

KEEP_BARRIERS = {"xla_disable_hlo_passes": "cse_barrier_expander"}
Tree = TypeVar("Tree")


def barrier(tree: Tree) -> Tree:
    """The same arrays, computed once and not again inside the loops of the stage that uses them."""
    return jax.lax.optimization_barrier(tree)


def compiler_options() -> dict[str, Any]:
    """Options for the platform that JAX computes on, for `jax.jit` and for `compile` of a lowered function."""
    return dict(KEEP_BARRIERS) if jax.default_backend() == "cpu" else {}


def jit(function: Callable[..., Any], **options: Any) -> Any:
    """`jax.jit` that keeps barriers."""
    return jax.jit(function, compiler_options=compiler_options(), **options)


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator: `eqx.filter_jit` that keeps barriers. The platform is asked for at the first call, not at import."""

    @functools.cache
    def build() -> Callable[..., Any]:
        options: dict[str, Any] = {"compiler_options": compiler_options()}  # passed on to jax.jit
        return eqx.filter_jit(function, **options)

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        return build()(*args, **kwargs)

    return call
