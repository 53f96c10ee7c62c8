"""One training step, a pure function of its state: draw rays, choose samples, descend, keep the grid up to date."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from datasets.core.errors import UsageError
from reconstruct.config import Config
from reconstruct.field.cloud import Cloud
from reconstruct.field.mlp import computed_in
from reconstruct.rendering.model import Footprint, Model, cloud_of, render
from reconstruct.sampling import focus
from reconstruct.sampling.occupancy import Occupancy
from reconstruct.sampling.packing import draw, draw_probability, expected_depth, packed_samples
from reconstruct.sampling.proposal import Spacing, propose
from reconstruct.sampling.samples import RaySamples
from reconstruct.sampling.steps import Steps
from reconstruct.scene.rays import Normalisation, Pixels, Rays
from reconstruct.scene.twists import followed, moved, without_gauge
from reconstruct.training import objective
from reconstruct.training.faults import FAULTS, finite_parts, packed
from reconstruct.training.schedules import encoding_blur, late, learning_rate

GRID_PERIOD, GRID_CELLS = 16, 65536
"""Every so many steps the occupancy grid looks at so many cells."""
SAMPLES_PER_RAY = 8
"""The packed list is planned for rays that need at least so many samples each."""


def _separate(tree):
    """Keep the compiler from recomputing one stage inside the loops of the next."""
    return jax.lax.optimization_barrier(tree)


class TrainState(eqx.Module):
    """All that a training is, apart from the pixels: enough to continue to the same result."""

    model: Model
    optimiser: optax.OptState
    occupancy: Occupancy | None
    step: Int[Array, ""]
    skipped: Int[Array, ""]
    """Steps whose gradient was not finite: left out, counted and shown."""


@dataclass(frozen=True)
class StepFunctions:
    """The step for one configuration and one scene. Static choices are made here, before compilation."""

    config: Config
    normalisation: Normalisation
    mesh: jax.sharding.Mesh | None = None
    """Devices among which each batch is divided; None for one."""

    @property
    def _bounded(self) -> bool:
        return self.normalisation.bounded

    @property
    def _place(self) -> objective.Place:
        sampler = self.config.sampler
        return objective.Place(self._bounded, extended=sampler.kind == "proposal" and sampler.frustum != "point")

    def initial(self, key: PRNGKeyArray, possible, views: int = 0) -> TrainState:
        """Fresh weights and a full grid (less what masks rule out), for a training on so many views."""
        model = Model.create(key, self.config if self._bounded else self.config.with_surroundings(), views)
        sampler, occupancy = self.config.sampler, None
        if sampler.kind == "occupancy":
            occupancy = Occupancy.create(
                key, grid=sampler.grid, outer_grid=sampler.outer_grid, bounded=self._bounded, possible=possible
            )
        return TrainState(model, self._adam().init(model), occupancy, jnp.zeros((), jnp.int32), jnp.zeros((), jnp.int32))

    def advance(
        self,
        state: TrainState,
        pixels: Pixels,
        seed: Int[Array, ""],
        progress: Float[Array, ""],
        count: Int[Array, ""],
        second: Bool[Array, ""],
    ) -> tuple[TrainState, objective.Terms]:
        """`count` steps, the last of them with the regularisers' second pass where `second` is true.

        Returns:
            The new state and the last step's terms, among them the faults of all of them (see `faults`).
        """

        def one(i, carry):
            state, terms = self._step(carry[0], pixels, seed, progress, second & (i == count - 1))
            return state, terms | {FAULTS: terms[FAULTS] | carry[1][FAULTS]}

        shapes = jax.eval_shape(lambda s: self._step(s, pixels, seed, progress, second), state)[1]
        empty = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes)
        return jax.lax.fori_loop(0, count, one, (state, empty))

    def _adam(self) -> optax.GradientTransformation:
        return optax.scale_by_adam(b1=0.9, b2=0.99, eps=1e-15)

    def _step(self, state: TrainState, pixels: Pixels, seed, progress, second) -> tuple[TrainState, objective.Terms]:
        state = self._sharpened(state, progress)
        key, count = jax.random.fold_in(jax.random.key(seed), state.step), self.config.train.accumulate
        if count == 1:
            gradient, terms, met = self._batch(state, pixels, key, progress, second)
        else:

            def add(total: Model, key: PRNGKeyArray):
                gradient, *rest = self._batch(state, pixels, key, progress, second)
                return jax.tree.map(jnp.add, total, gradient), rest

            nothing = jax.tree.map(jnp.zeros_like, state.model)
            gradient, (terms, met) = jax.lax.scan(add, nothing, jax.random.split(key, count))
            gradient = jax.tree.map(lambda g: g / count, gradient)
            terms, met = jax.tree.map(lambda t: jnp.mean(t, 0), terms), jax.tree.map(jnp.ravel, met)
        finite = finite_parts(gradient)
        terms |= {FAULTS: packed(finite, terms)}
        state = self._descend(state, gradient, progress, jnp.all(jnp.stack(list(finite.values()))), pixels)
        if met is not None:  # keep in the grid what the step met anyway
            state = eqx.tree_at(lambda s: s.occupancy, state, state.occupancy.seen(*met))
        return state, terms

    def _batch(self, state: TrainState, pixels: Pixels, key: PRNGKeyArray, progress, second):
        """Gradient and terms of one batch; with an occupancy grid also the cells that it met and their densities."""
        keys = dict(zip(("pixels", "samples", "background", "sphere"), jax.random.split(key, 4), strict=True))
        index = self._pixels(state, pixels, keys["pixels"])
        rays, colour = _separate(pixels.take(_separate(self._spread(index))))
        rays = moved(rays, state.model.poses)
        batch = _separate(self._spread(self._choose(state, rays, colour, keys["samples"])))
        loss = lambda model: self._loss(model, batch, keys, progress)  # noqa: E731
        (_, (terms, density, surface)), gradient = _separate(jax.value_and_grad(loss, has_aux=True)(state.model))
        if self.config.surface.enabled:
            gradient, more = self._second_pass(state.model, gradient, batch[0], surface, keys["sphere"], second)
            terms |= more
        if state.occupancy is None:
            return gradient, terms, None
        rays, _, _, samples = batch
        points, _ = cloud_of(rays, samples, bounded=self._bounded, footprint=Footprint()).contracted()
        return gradient, terms, (state.occupancy.cell(*points), jnp.where(samples.valid, density, 0.0))

    def _pixels(self, state: TrainState, pixels: Pixels, key: PRNGKeyArray) -> Int[Array, " drawn"]:
        """Pixels of a batch: random ones, among surroundings rather those that show the object."""
        total, candidates, half_box = pixels.directions.shape[0], self.config.sampler.candidates, self.config.field.half_box
        if self._bounded or state.occupancy is None or half_box is None or candidates in (None, 1):
            return jax.random.randint(key, (self._drawn,), 0, total)
        index_key, jitter_key, order_key = jax.random.split(key, 3)
        index = jax.random.randint(index_key, (candidates * self._drawn,), 0, total)
        rays, _ = _separate(pixels.take(_separate(index)))
        weights = focus.weights(state.occupancy, rays, half_box, jax.random.uniform(jitter_key, index.shape))
        return index[focus.taken(order_key, weights, self._drawn)]

    def _spread(self, tree):
        """The arrays of a batch divided among the devices along their first axis; everything else is everywhere."""
        if self.mesh is None:
            return tree
        part = jax.sharding.NamedSharding(self.mesh, jax.sharding.PartitionSpec(*self.mesh.axis_names))
        return jax.tree.map(lambda a: jax.lax.with_sharding_constraint(a, part), tree)

    def _sharpened(self, state: TrainState, progress) -> TrainState:
        """The state with the blur of its progress."""
        train = self.config.train
        blur = encoding_blur(progress, first=train.first_blur, last=train.last_blur, until=train.blur_until)
        return eqx.tree_at(lambda s: s.model.field.encoding.blur, state, blur.astype(jnp.float32))

    def _second_pass(self, model: Model, gradient: Model, rays: Rays, surface, key, second) -> tuple[Model, objective.Terms]:
        """The gradient with the regularisers' added where `second` is true; elsewhere nothing is computed."""

        def weighted(model: Model):
            model = computed_in(self.config.train.precision, model)
            terms = objective.second_pass_terms(model.field, rays, surface, key, self.config.surface, self._place)
            return objective.total(terms), terms

        def with_regularisers(gradient: Model):
            (_, terms), more = jax.value_and_grad(weighted, has_aux=True)(model)
            return jax.tree.map(jnp.add, gradient, more), terms

        nothing = {name: jnp.zeros(()) for name in jax.eval_shape(lambda: weighted(model)[1])}
        return jax.lax.cond(second, with_regularisers, lambda gradient: (gradient, nothing), gradient)

    def over(self, devices: Sequence[jax.Device]) -> "StepFunctions":
        """The same on as many of the devices as divide every batch evenly; on one, nothing is divided.

        Raises:
            UsageError: the devices are of several processes, none of which can be left out, and do not divide every batch.
        """
        sampler = self.config.sampler
        batches = (self._drawn, self._kept) if sampler.kind == "proposal" else (self._drawn, self._kept, sampler.samples)
        count = math.gcd(len(devices), *batches)
        if count < len(devices) and len({device.process_index for device in devices}) > 1:
            raise UsageError(f"{len(devices)} devices do not divide a batch evenly", where="sampler.rays and sampler.samples",
                         why=f"{', '.join(map(str, sorted(set(batches))))}", remedy="choose multiples, or another number of processes")  # fmt: skip
        mesh = None if count == 1 else jax.sharding.Mesh(np.array(devices[:count]), ("rays",))
        return replace(self, mesh=mesh)

    @property
    def everywhere(self) -> jax.sharding.NamedSharding | None:
        """How states and pixels lie on the devices: whole on each. None for one device."""
        return None if self.mesh is None else jax.sharding.NamedSharding(self.mesh, jax.sharding.PartitionSpec())

    @property
    def rays_per_step(self) -> int:
        """Rays drawn per step, those that meet nothing included."""
        return self._drawn * self.config.train.accumulate

    @property
    def samples_per_step(self) -> int:
        """Places per step at which the field is evaluated for the picture; with an occupancy grid, entries of the list, filled or not."""
        sampler = self.config.sampler
        return (sampler.samples if sampler.kind == "occupancy" else self._drawn * sampler.final) * self.config.train.accumulate

    @property
    def _kept(self) -> int:
        """Rays of a batch once those that meet nothing are dropped."""
        sampler = self.config.sampler
        if sampler.kind == "proposal" or not self.config.skip.empty_rays:
            return self._drawn
        return min(self._drawn, sampler.samples // SAMPLES_PER_RAY)

    @property
    def _drawn(self) -> int:
        sampler = self.config.sampler
        if sampler.kind == "occupancy" and not self._bounded:
            return min(sampler.rays, sampler.samples // sampler.max_per_ray)  # every ray meets the surroundings
        return sampler.rays

    def _choose(self, state: TrainState, rays: Rays, colour, key):
        """Samples of the rays that have any; `None` for proposals, which are part of what is differentiated."""
        if state.occupancy is None:
            return rays, colour, jnp.ones(self._drawn, bool), None
        sampler = self.config.sampler
        jitter, offset = _separate(jax.random.uniform(key, (2, self._drawn)))
        depth = _separate(expected_depth(state.occupancy, rays, self.steps(rays), jitter, self._bounded))
        hit = jnp.any(depth > 0, -1)
        kept = self._kept
        if kept < self._drawn:  # empty rays have nothing to learn from
            (order,) = jnp.nonzero(hit, size=kept, fill_value=0)
            depth = jnp.where((jnp.arange(kept) < jnp.sum(hit))[:, None], depth[order], 0)
            rays, colour, jitter, offset, depth = _separate(
                (*jax.tree.map(lambda a: a[order], (rays, colour, jitter, offset)), depth)
            )
            hit = jnp.any(depth > 0, -1)
        samples, fits = self.sampled(depth, rays, jitter, offset, sampler.samples)
        return rays, colour, fits & hit, samples

    def sampled(self, depth, rays: Rays, jitter, offset, capacity: int) -> tuple[RaySamples, Bool[Array, " rays"]]:
        """Samples of rays whose steps' expected optical depth is known, and which rays found room."""
        longest = self.config.sampler.max_per_ray
        probability = _separate(draw_probability(depth, longest - 1))
        words = _separate(draw(probability, offset))
        return packed_samples(words, probability, self.steps(rays), jitter, capacity=capacity, max_per_ray=longest)

    def steps(self, rays: Rays) -> Steps:
        """How rays of this scene are cut into steps."""
        n = self.normalisation
        return Steps.of(rays, steps=self.config.sampler.steps, bounded=n.bounded, near=n.near, far=n.far)

    def _loss(self, model: Model, batch, keys, progress):
        model = computed_in(self.config.train.precision, model)
        rays, colour, used, samples = batch
        config, terms, footprint = self.config, {}, Footprint()
        weights = config.losses.in_scene(bounded=self._bounded)
        seen = followed(rays, model.poses)  # poses follow the picture; where else the field is looked at is data
        if samples is None:
            samples, sdist, levels, footprint = self.propose(model, rays, keys["samples"])
        cloud = replace(cloud_of(seen, samples, bounded=self._bounded, footprint=footprint), followed=model.poses is not None)
        rendered, density = render(model.field, seen, samples, cloud, deferred=config.field.shading == "deferred")
        if model.poses is not None and config.poses.prior:
            terms |= objective.pose_term(model.poses / self._pose_sigma, config.poses.prior)
        if model.per_image is not None:
            rendered = rendered.exposed((model.per_image - jnp.mean(model.per_image, 0))[rays.view])
        background = jax.random.uniform(keys["background"], (rays.origins.shape[0], 3))
        terms |= objective.photometric(rendered, colour, background, used, weights.charbonnier)
        if model.proposals:
            terms |= objective.interlevel_terms(sdist, rendered.weights, levels, weights.interlevel)
        if weights.distortion:
            terms |= objective.distortion_term(rendered, samples, jnp.asarray(1.0), weights.distortion)
        if weights.hollowness:
            weight = weights.hollowness * late(progress, start=weights.hollow_from)
            terms |= objective.hollowness_term(rendered, density, samples, weight)
        if weights.decay:
            terms |= objective.decay_term(model, weights.decay)
        surface = objective.surfaces_of(rendered, samples, rays, config.surface.rays)
        terms |= objective.surface_point_terms(model.field, rays, surface, weights, self._place)
        return objective.total(terms), (terms, jax.lax.stop_gradient(density), surface)

    def propose(self, model: Model, rays: Rays, key: PRNGKeyArray | None):
        """Final samples of the proposal sampler, their sdist, the levels, and what stands for the frustums."""
        sampler, spacing = self.config.sampler, Spacing.of(self.normalisation)
        turn = None
        if sampler.frustum == "hexagon":
            count = rays.origins.shape[0]
            turn = jnp.zeros(count) if key is None else 2 * jnp.pi * jax.random.uniform(key, (count,))
        footprint = Footprint(sampler.frustum, turn)
        density_at = lambda p, r, t: objective.proposal_density(p, r, t, bounded=self._bounded, footprint=footprint)  # noqa: E731
        sdist, levels = propose(model.proposals, rays, spacing, key, sampler, density_at)
        return RaySamples.from_edges(spacing.t(sdist)), sdist, levels, footprint

    def _descend(self, state: TrainState, gradient: Model, progress, finite: Bool[Array, ""], pixels: Pixels) -> TrainState:
        """Adam; a gradient that is not finite changes nothing and is counted."""
        train = self.config.train
        rate = learning_rate(progress, rate=train.rate, final_rate=train.final_rate, warmup=train.warmup)
        update, optimiser = self._adam().update(gradient, state.optimiser)
        rates = jax.tree_util.tree_map_with_path(lambda path, _: rate * self._share(path), state.model)
        model = jax.tree.map(lambda p, u, r: p - r * u, state.model, update, rates)
        if state.model.poses is not None:
            step = self._pose_rate(progress) * without_gauge(update.poses, pixels.origins, self._pose_sigma)
            model = eqx.tree_at(lambda m: m.poses, model, state.model.poses - step * self._pose_sigma)
        keep = lambda new, old: jax.tree.map(lambda a, b: jnp.where(finite, a, b), new, old)  # noqa: E731
        return TrainState(keep(model, state.model), keep(optimiser, state.optimiser), state.occupancy, state.step + 1,
                          state.skipped + jnp.where(finite, 0, 1))  # fmt: skip

    @property
    def _pose_sigma(self) -> Float[Array, " 6"]:
        """Standard deviations of a pose as it was calibrated, as a twist has them [scene unit, rad]."""
        return jnp.array(self.config.poses.sigma(self.normalisation.scale))

    def _pose_rate(self, progress) -> Float[Array, ""]:
        """Learning rate of poses, in standard deviations."""
        poses = self.config.poses
        return late(progress, start=poses.start) * learning_rate(
            progress, rate=poses.rate, final_rate=poses.final_rate, warmup=0.0
        )

    def _share(self, path: tuple) -> float:
        """Factor on the learning rate of the parameter at `path`: tables see few samples each, networks all of them."""
        return 1.0 if any(getattr(part, "name", "") == "table" for part in path) else self.config.train.network_share

    def look_around(self, state: TrainState, seed: Int[Array, ""]) -> TrainState:
        """Look at the next cells of the occupancy grid; wanted every `GRID_PERIOD` steps."""
        key = jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), state.step), GRID_PERIOD)
        density_of = lambda p: state.model.field.density(Cloud(p, None, bounded=True))  # noqa: E731
        empty_below = self.config.sampler.optical_depth if self.config.skip.empty_rays else 0.0
        occupancy = state.occupancy.updated(density_of, key, GRID_CELLS, empty_below)
        return eqx.tree_at(lambda s: s.occupancy, state, occupancy)
