"""The stages of a training step, as pure functions: a batch and its gradient, the second pass, the descent."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray
from numpy.typing import NDArray

from koala3d.reconstruct.config import Config
from koala3d.reconstruct.field.encodings.grid import HashedGrid
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.numerics.compiling import barrier, compiler_options
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.sampling.create import sampler_type
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Pixels, Rays
from koala3d.reconstruct.surface.first_surface import Surfaces
from koala3d.reconstruct.surface.place import Place
from koala3d.reconstruct.surface.second_pass import SecondPass
from koala3d.reconstruct.training.batches import ONE_DEVICE, Division, drawn_batch
from koala3d.reconstruct.training.faults import FAULTS, finite_parts, packed
from koala3d.reconstruct.training.objective import Objective, Terms, total
from koala3d.reconstruct.training.optimiser import Optimiser
from koala3d.reconstruct.training.programs import Programs, traced
from koala3d.reconstruct.training.schedule import Schedule

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


class Part(eqx.Module):
    """What a step has found out before its descent: its gradient, what it costs, and what later stages need."""

    gradient: Model
    terms: Terms
    met: Any
    """What the sampler learns from it."""
    rays: Rays
    surfaces: Surfaces


@dataclass(frozen=True)
class Step:
    """The step for one configuration and one scene, in stages that `Programs` compiles. Static choices are made here."""

    config: Config
    facts: SceneFacts
    objective: Objective
    second_pass: SecondPass | None
    optimiser: Optimiser
    schedule: Schedule
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
            Schedule(config),
        )

    def initial(
        self, key: PRNGKeyArray, possible: NDArray[Any] | None = None, views: int = 0, hull: NDArray[Any] | None = None
    ) -> TrainState:
        """Fresh weights, for a training on this many views; `possible` and `hull` as of `Model.create`."""
        model = Model.create(key, self.config, self.facts, views, possible, hull)
        moments = self.optimiser.begin(model.split()[0])
        return TrainState(model, moments, jnp.zeros((), jnp.int32), jnp.zeros((), jnp.int32))

    def compiled(self, state: TrainState, pixels: Pixels, **options: Any) -> Programs:
        """The stages of a step, compiled for such a state and such pixels; they use up the state that they are given.

        Args:
            options: of the compiler, beside those of the platform.
        """
        return Programs.of(self, state, pixels, options)

    def compiled_upkeep(self, state: TrainState, **options: Any) -> Any:
        """`kept_up`, compiled for such a state, which it uses up."""
        stage = traced(self.kept_up, (state, jax.ShapeDtypeStruct((), jnp.int32)), self.division, uses_up=(0,))
        return stage.lower().compile(compiler_options={**compiler_options(), **options})

    def _keys(self, step: Int[Array, ""], seed: Int[Array, ""]) -> dict[str, PRNGKeyArray]:
        """Random keys of a step."""
        key = jax.random.fold_in(jax.random.key(seed), step)
        return dict(zip(("pixels", "samples", "background", "sphere"), jax.random.split(key, 4), strict=True))

    def _blurred(self, model: Model, progress: Float[Array, ""]) -> Model:
        """The model as it is trained at this time."""
        blur, gain = self.schedule.blur(progress), self.schedule.gain(progress)
        return model.blurred(blur.astype(jnp.float32)).freed(gain.astype(jnp.float32))

    def begun(
        self,
        model: Model,
        step: Int[Array, ""],
        pixels: Pixels,
        seed: Int[Array, ""],
        progress: Float[Array, ""],
        looks: Bool[Array, ""],
    ) -> Part:
        """Draw a batch and find its gradient, without the second pass. `looks`: as of `Sampler.batch`."""
        keys, model = self._keys(step, seed), self._blurred(model, progress)
        batch = drawn_batch(model, pixels, keys["pixels"], keys["samples"], looks, self.division)
        learned, held = model.split()
        loss = lambda learned: self.objective(  # noqa: E731
            eqx.combine(learned, held), batch, keys["samples"], keys["background"], progress
        )
        (_, (terms, density, surfaces)), gradient = barrier(jax.value_and_grad(loss, has_aux=True)(learned))
        at_surfaces = lambda field: self.objective.at_surfaces(field, batch.rays, surfaces, progress)  # noqa: E731
        gradient, more = _added(at_surfaces, model, gradient)
        surfaces = surfaces.of_rays(self.objective.second_rays)
        return Part(gradient, terms | more, model.sampler.met(batch, density), batch.rays, surfaces)

    def regularised(
        self, model: Model, step: Int[Array, ""], part: Part, seed: Int[Array, ""], progress: Float[Array, ""]
    ) -> Part:
        """The same batch with the gradient and the terms of the regularisers' second pass."""
        assert self.second_pass is not None
        surfaces, key = self.division.spread_evenly(part.surfaces), self._keys(step, seed)["sphere"]
        bias, second_pass = self.schedule.bias(progress).astype(jnp.float32), self.second_pass

        def weighted(field: Field) -> tuple[Float[Array, ""], Terms]:
            terms = second_pass.terms(field, part.rays, surfaces, key, bias)
            return total(terms), terms

        gradient, terms = _added(weighted, self._blurred(model, progress), part.gradient)
        return replace(part, gradient=gradient, terms=part.terms | terms)

    def descended(
        self,
        state: TrainState,
        part: Part,
        origins: Float[Array, "views 3"],
        progress: Float[Array, ""],
        faults: Int[Array, ""],
    ) -> tuple[TrainState, Terms]:
        """The state after a step down the gradient of a batch, and its terms.

        Args:
            origins: the cameras' positions.
            faults: those of the steps before, which are added to this step's.
        """
        terms = dict(part.terms)
        learned, held = self._blurred(state.model, progress).split()
        finite = finite_parts(part.gradient)
        terms[FAULTS] = packed(finite, terms) | faults
        good = jnp.all(jnp.stack(list(finite.values())))
        learned, moments = self.optimiser.descended(learned, part.gradient, state.optimiser, progress, good, origins)
        model = eqx.combine(learned, held)
        model = replace(model, sampler=model.sampler.with_met(part.met))
        return TrainState(model, moments, state.step + 1, state.skipped + jnp.where(good, 0, 1)), terms

    def kept_up(self, state: TrainState, seed: Int[Array, ""]) -> TrainState:
        """The state with its sampler brought up to date; see `Sampler.upkeep_due`."""
        key = jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), state.step), UPKEEP)
        sampler = state.model.sampler.upkept(state.model.field, key)
        return eqx.tree_at(lambda s: s.model.sampler, state, sampler)


def _added(loss: Callable[[Field], tuple[Float[Array, ""], Terms]], model: Model, gradient: Model) -> tuple[Model, Terms]:
    """The sum of a gradient and that of a loss which evaluates the field's encoding once, and the loss's terms."""
    learned, held = model.split()
    encoding = lambda tree: tree.field.encoding  # noqa: E731
    in_place = isinstance(encoding(model), HashedGrid)

    def on(learned: Model) -> tuple[Float[Array, ""], Terms]:
        whole = eqx.combine(learned, held)
        if in_place:
            whole = eqx.tree_at(encoding, whole, encoding(whole).adding_to(encoding(gradient)))
        return loss(whole.field)

    more, terms = jax.grad(on, has_aux=True)(learned)
    added = jax.tree.map(jnp.add, gradient, more)
    return eqx.tree_at(encoding, added, encoding(more)) if in_place else added, terms
