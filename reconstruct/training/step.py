"""One training step, a pure function of its state: draw a batch, find the gradient, descend, note what was met."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray
from numpy.typing import NDArray

from reconstruct.config import Config
from reconstruct.field.mlp import computed_in
from reconstruct.numerics.compiling import barrier, compiler_options
from reconstruct.rendering.model import Model
from reconstruct.sampling.create import sampler_type
from reconstruct.sampling.sampler import Batch
from reconstruct.scene.facts import SceneFacts
from reconstruct.scene.rays import Pixels
from reconstruct.surface.first_surface import Surface
from reconstruct.surface.second_pass import Place, SecondPass
from reconstruct.training.batches import ONE_DEVICE, Division, drawn_batch
from reconstruct.training.faults import FAULTS, finite_parts, packed
from reconstruct.training.objective import Objective, Terms, total
from reconstruct.training.optimiser import Optimiser
from reconstruct.training.schedules import encoding_blur

UPKEEP = 16
"""Folded into the random key of a sampler's upkeep."""


class TrainState(eqx.Module):
    """All that a training is, apart from the pixels: enough to continue to the same result."""

    model: Model
    optimiser: optax.OptState
    """Of what is learned, see `Model.split`."""
    step: Int[Array, ""]
    skipped: Int[Array, ""]
    """Steps whose gradient was not finite: left out, counted and shown."""


@dataclass(frozen=True)
class Step:
    """The step for one configuration and one scene. Static choices are made here, before compilation."""

    config: Config
    facts: SceneFacts
    objective: Objective
    second_pass: SecondPass | None
    optimiser: Optimiser
    division: Division = ONE_DEVICE

    @classmethod
    def of(cls, config: Config, facts: SceneFacts) -> "Step":
        """As configured, on one device."""
        frustum = sampler_type(config.sampler).frustum_of(config.sampler)
        place = Place(facts.normalisation.space, extended=frustum != "point")
        return cls(
            config,
            facts,
            Objective.of(config, facts, place),
            SecondPass(place, config.surface) if config.surface.enabled else None,
            Optimiser.of(config, facts),
        )

    def initial(self, key: PRNGKeyArray, possible: NDArray[Any] | None = None, views: int = 0) -> TrainState:
        """Fresh weights, for a training on this many views. `possible`: see `Sampler.possible_cells`."""
        model = Model.create(key, self.config, self.facts, views, possible)
        moments = self.optimiser.begin(model.split()[0])
        return TrainState(model, moments, jnp.zeros((), jnp.int32), jnp.zeros((), jnp.int32))

    def compiled(self, state: TrainState, pixels: Pixels, **options: Any) -> Any:
        """`advance`, compiled for such a state and such pixels; it uses up the state that it is given.

        Args:
            options: of the compiler, beside those of the platform.
        """
        scalars = [jax.ShapeDtypeStruct((), dtype) for dtype in (jnp.int32, jnp.float32, jnp.int32, jnp.bool_)]
        return self._compiled(self.advance, (state, pixels, *scalars), options)

    def compiled_upkeep(self, state: TrainState, **options: Any) -> Any:
        """`kept_up`, compiled for such a state, which it uses up."""
        return self._compiled(self.kept_up, (state, jax.ShapeDtypeStruct((), jnp.int32)), options)

    def _compiled(self, function: Callable[..., Any], arguments: tuple[Any, ...], options: dict[str, Any]) -> Any:
        everywhere = self.division.everywhere
        placed: dict[str, Any] = {} if everywhere is None else {"out_shardings": everywhere}
        lowered = jax.jit(function, donate_argnums=(0,), **placed).lower(*arguments)
        return lowered.compile(compiler_options={**compiler_options(), **options})

    def advance(
        self,
        state: TrainState,
        pixels: Pixels,
        seed: Int[Array, ""],
        progress: Float[Array, ""],
        count: Int[Array, ""],
        second: Bool[Array, ""],
    ) -> tuple[TrainState, Terms]:
        """`count` steps, the last of them with the regularisers' second pass where `second` is true.

        Returns:
            The new state and the last step's terms, among them the faults of all of them (see `faults`).
        """

        def one(i: Int[Array, ""], carry: tuple[TrainState, Terms]) -> tuple[TrainState, Terms]:
            state, terms = self(carry[0], pixels, seed, progress, second & (i == count - 1))
            return state, terms | {FAULTS: terms[FAULTS] | carry[1][FAULTS]}

        shapes = jax.eval_shape(lambda s: self(s, pixels, seed, progress, second), state)[1]
        empty = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes)
        return jax.lax.fori_loop(0, count, one, (state, empty))

    def __call__(
        self, state: TrainState, pixels: Pixels, seed: Int[Array, ""], progress: Float[Array, ""], second: Bool[Array, ""]
    ) -> tuple[TrainState, Terms]:
        """One step."""
        train = self.config.train
        blur = encoding_blur(progress, first=train.first_blur, last=train.last_blur, until=train.blur_until)
        model = state.model.blurred(blur.astype(jnp.float32))
        learned, held = model.split()
        key, count = jax.random.fold_in(jax.random.key(seed), state.step), train.accumulate
        if count == 1:
            gradient, terms, met = self.gradient(model, pixels, key, progress, second)
        else:

            def add(summed: Model, key: PRNGKeyArray) -> tuple[Model, list[Any]]:
                gradient, *rest = self.gradient(model, pixels, key, progress, second)
                return jax.tree.map(jnp.add, summed, gradient), rest

            nothing = jax.tree.map(jnp.zeros_like, learned)
            gradient, (terms, met) = jax.lax.scan(add, nothing, jax.random.split(key, count))
            gradient = jax.tree.map(lambda g: g / count, gradient)
            terms, met = jax.tree.map(lambda t: jnp.mean(t, 0), terms), jax.tree.map(jnp.ravel, met)
        finite = finite_parts(gradient)
        terms |= {FAULTS: packed(finite, terms)}
        good = jnp.all(jnp.stack(list(finite.values())))
        learned, moments = self.optimiser.descended(learned, gradient, state.optimiser, progress, good, pixels.origins)
        model = eqx.combine(learned, held)
        model = replace(model, sampler=model.sampler.with_met(met))
        return TrainState(model, moments, state.step + 1, state.skipped + jnp.where(good, 0, 1)), terms

    def gradient(
        self, model: Model, pixels: Pixels, key: PRNGKeyArray, progress: Float[Array, ""], second: Bool[Array, ""]
    ) -> tuple[Model, Terms, Any]:
        """Gradient and terms of one batch, and what the sampler learns from it."""
        keys = dict(zip(("pixels", "samples", "background", "sphere"), jax.random.split(key, 4), strict=True))
        batch = drawn_batch(model, pixels, keys["pixels"], keys["samples"], self.division)
        learned, held = model.split()
        loss = lambda learned: self.objective(  # noqa: E731
            eqx.combine(learned, held), batch, keys["samples"], keys["background"], progress
        )
        (_, (terms, density, surface)), gradient = barrier(jax.value_and_grad(loss, has_aux=True)(learned))
        if self.second_pass is not None:
            gradient, more = self._with_second_pass(self.second_pass, model, gradient, batch, surface, keys["sphere"], second)
            terms |= more
        return gradient, terms, model.sampler.met(batch, density)

    def _with_second_pass(
        self,
        regularisers: SecondPass,
        model: Model,
        gradient: Model,
        batch: Batch,
        surface: Surface,
        key: PRNGKeyArray,
        second: Bool[Array, ""],
    ) -> tuple[Model, Terms]:
        """The gradient with the regularisers' added where `second` is true; elsewhere nothing is computed."""
        learned, held = model.split()

        def weighted(learned: Model) -> tuple[Float[Array, ""], Terms]:
            model = computed_in(self.config.train.precision, eqx.combine(learned, held))
            terms = regularisers.terms(model.field, batch.rays, surface, key)
            return total(terms), terms

        def with_regularisers(gradient: Model) -> tuple[Model, Terms]:
            (_, terms), more = jax.value_and_grad(weighted, has_aux=True)(learned)
            return jax.tree.map(jnp.add, gradient, more), terms

        nothing = {name: jnp.zeros(()) for name in jax.eval_shape(lambda: weighted(learned)[1])}
        return jax.lax.cond(second, with_regularisers, lambda gradient: (gradient, nothing), gradient)

    def kept_up(self, state: TrainState, seed: Int[Array, ""]) -> TrainState:
        """The state with its sampler brought up to date; see `Sampler.upkeep_due`."""
        key = jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), state.step), UPKEEP)
        sampler = state.model.sampler.upkept(state.model.field, key)
        return eqx.tree_at(lambda s: s.model.sampler, state, sampler)
