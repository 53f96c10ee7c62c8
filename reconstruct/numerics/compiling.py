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
PLAIN_SUMS = {"xla_cpu_experimental_ynn_fusion_type": ""}
"""Sums stay with XLA's own loops. Those of its library YNNPACK are wrong where a factor is repeated along an axis in the middle:
jaxlib 0.10.2 gives sum(a[:, None] * b, 0) of (16, n) and (16, 3, n) three times its first row from n = 16,384 on. They would make
a step 4 % faster."""
Tree = TypeVar("Tree")


def barrier(tree: Tree) -> Tree:
    """The same arrays, computed once and not again inside the loops of the stage that uses them."""
    return jax.lax.optimization_barrier(tree)


def compiler_options() -> dict[str, Any]:
    """Options for the platform that JAX computes on, for `jax.jit` and for `compile` of a lowered function."""
    if jax.default_backend() != "cpu":
        return {}
    return KEEP_BARRIERS | PLAIN_SUMS if _known(*PLAIN_SUMS.items()) else dict(KEEP_BARRIERS)


@functools.cache
def _known(option: tuple[str, str]) -> bool:
    """Whether this version of XLA has an option."""
    try:
        jax.jit(lambda: 0, compiler_options=dict([option])).lower().compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True


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
