"""Steps that are not finite: which part of the model or which loss caused them, packed into one integer on the device.

Such a step changes nothing, is counted and shown with its cause; a training in which it recurs ends.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from koala3d.reconstruct.kernels.squares import sum_of_squares

FAULTS = "faults"
"""Key of the faults among a step's terms."""
RECURS = 3
"""This many steps that are not finite end a training."""

Tree = Any


def parts_of(model: Tree) -> list[str]:
    """Names of the parts of a model, such as "field.encoding", in the order of `finite_parts`."""
    return list(dict.fromkeys(_part(path) for path, _ in jax.tree.leaves_with_path(model)))


def finite_parts(gradient: Tree) -> dict[str, Bool[Array, ""]]:
    """Whether each part's gradient is finite, and small enough that Adam can square it."""
    squares: dict[str, Array] = {}
    for path, leaf in jax.tree.leaves_with_path(gradient):
        squares[_part(path)] = squares.get(_part(path), jnp.zeros(())) + sum_of_squares(leaf)
    return {part: jnp.isfinite(total) for part, total in squares.items()}


def packed(finite: dict[str, Bool[Array, ""]], terms: dict[str, Array]) -> Int[Array, ""]:
    """A bit per part of the model and per loss (in the order of its name), set where it is not finite."""
    flags = [*finite.values(), *(jnp.isfinite(terms[name]) for name in sorted(terms))]
    return sum((jnp.where(flag, 0, 1 << bit) for bit, flag in enumerate(flags)), jnp.zeros((), jnp.int32))


def cause(faults: int, model: Tree, terms: dict[str, Any]) -> str:
    """Faults in words; empty where there are none.

    Args:
        terms: those of the step without the faults.
    """
    names = [f"gradient of {part}" for part in parts_of(model)]
    names += [f"loss {name}" for name in sorted(terms) if name != FAULTS]
    return ", ".join(name for bit, name in enumerate(names) if faults >> bit & 1)


def _part(path: tuple) -> str:
    """The model's part that a leaf belongs to: two names deep in field and sampler, one elsewhere."""
    names = [part.name for part in path if hasattr(part, "name")]
    return ".".join(names[:2] if names[:1] in (["field"], ["sampler"]) else names[:1])
