"""A step as compiled programs: the gradient of a batch, the regularisers' second pass, the descent.

One after the other on the device, with nothing read back between them. A step without the second pass leaves its program out;
nothing is compiled twice, and no state passes through a loop or a branch, where the compiler would copy it.
"""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from koala3d.reconstruct.numerics.compiling import compiler_options
from koala3d.reconstruct.scene.rays import Pixels
from koala3d.reconstruct.training.batches import Division
from koala3d.reconstruct.training.faults import FAULTS

if TYPE_CHECKING:
    from koala3d.reconstruct.training.objective import Terms
    from koala3d.reconstruct.training.step import Step, TrainState


def traced(function: Callable[..., Any], arguments: tuple[Any, ...], division: Division, uses_up: tuple[int, ...] = ()) -> Any:
    """A function traced for such arguments, of which it uses up some; its results are everywhere."""
    placed: dict[str, Any] = {} if division.everywhere is None else {"out_shardings": division.everywhere}
    return jax.jit(function, donate_argnums=uses_up, **placed).trace(*arguments)


@dataclass(frozen=True)
class Programs:
    """The compiled stages of a `Step`, called as if they were one program."""

    begin: Any
    regularise: Any
    """None where there is no second pass."""
    descend: Any
    none: Int[Array, ""]
    """No faults."""
    nothing: dict[str, Array]
    """Terms of a second pass that is left out."""
    held_bytes: int
    """State, pixels and the results of the stages."""

    @classmethod
    def of(cls, step: "Step", state: "TrainState", pixels: Pixels, options: dict[str, Any]) -> "Programs":
        """Compiled for such a state and such pixels, all stages at the same time."""
        number, real, either = (jax.ShapeDtypeStruct((), dtype) for dtype in (jnp.int32, jnp.float32, jnp.bool))
        division = step.division
        chosen = {**compiler_options(), **options}
        with ThreadPoolExecutor() as threads:  # a stage is compiled while the next is traced

            def compiled(stage: Any) -> Future[Any]:
                return threads.submit(lambda: stage.lower().compile(compiler_options=chosen))

            stage = traced(step.begun, (state.model, state.step, pixels, number, real, either), division)
            part, known = _placed(stage.out_info, division), stage.out_info.terms.keys()
            begin, regularise = compiled(stage), None
            if step.second_pass is not None:
                stage = traced(step.regularised, (state.model, state.step, part, number, real), division, uses_up=(2,))
                part, regularise = _placed(stage.out_info, division), compiled(stage)
            descend = compiled(traced(step.descended, (state, part, pixels.origins, real, number), division, uses_up=(0,)))
        held = _bytes((state, pixels)) + (1 + (regularise is not None)) * _bytes(part)
        nothing = {name: jnp.zeros(()) for name in sorted(part.terms.keys() - known)}
        second = regularise.result() if regularise else None
        return cls(begin.result(), second, descend.result(), jnp.zeros((), jnp.int32), nothing, held)

    def __call__(
        self,
        state: "TrainState",
        pixels: Pixels,
        seed: Int[Array, ""],
        progress: Float[Array, ""],
        count: int | Int[Array, ""],
        second: Any,
        looks: Bool[Array, ""],
    ) -> tuple["TrainState", "Terms"]:
        """`count` steps, the last of them with the regularisers' second pass where `second` is true.

        Args:
            looks: as of `Sampler.batch`.

        Returns:
            The new state and the last step's terms, among them the faults of all of them (see `faults`).
        """
        faults, terms = self.none, {}
        for left in reversed(range(int(count))):
            part = self.begin(state.model, state.step, pixels, seed, progress, looks)
            if left == 0 and second and self.regularise is not None:
                part = self.regularise(state.model, state.step, part, seed, progress)
            elif self.nothing:
                part = replace(part, terms=part.terms | self.nothing)
            state, terms = self.descend(state, part, pixels.origins, progress, faults)
            faults = terms[FAULTS]
        return state, terms

    @property
    def stages(self) -> tuple[Any, ...]:
        """The compiled programs."""
        return tuple(program for program in (self.begin, self.regularise, self.descend) if program is not None)

    def needed_bytes(self) -> int:
        """Memory of a step as the compiler plans it: state and pixels, gradients, and what a stage keeps in between."""
        return self.held_bytes + max(int(program.memory_analysis().temp_size_in_bytes) for program in self.stages)


def _bytes(tree: Any) -> int:
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(tree))


def _placed(tree: Any, division: Division) -> Any:
    """Shapes of results as arguments of the next stage."""
    where = division.everywhere
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=where), tree)
