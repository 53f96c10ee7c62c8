"""What training minimises: the losses of rendered rays, and those at their first surfaces."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from koala3d.reconstruct.config import Config, LossConfig
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.field.mlp import computed_in
from koala3d.reconstruct.numerics.stepfun import resample_blurred
from koala3d.reconstruct.rendering.model import Model, Rendered, render
from koala3d.reconstruct.sampling.proposals import Level
from koala3d.reconstruct.sampling.sampler import Batch, Sampled
from koala3d.reconstruct.sampling.samples import RaySamples, cloud_of
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Rays, over
from koala3d.reconstruct.scene.twists import followed
from koala3d.reconstruct.surface.first_surface import Surface, Surfaces, find_surfaces, first_surface
from koala3d.reconstruct.surface.place import Place
from koala3d.reconstruct.training import losses
from koala3d.reconstruct.training.pace.schedules import between, late

Terms = dict[str, Float[Array, ""]]

SATURATED = 254.5 / 255
"""sRGB from which a channel of eight bits is clipped."""
FOGGY = 0.2
"""Share of the training before fog counts: at the start there is nothing else."""
SETTLED = 0.4
"""Share of the training from which the fog of the start is gone and the shape roughly right."""
FOLLOWING = (SETTLED, 0.8)
"""Shares of the training between which the density follows predicted normals ever more strongly."""
BLURS = (0.03, 0.003)
"""Half-widths of the interlevel loss's blur, in normalised distance (Zip-NeRF)."""


@dataclass(frozen=True)
class Objective:
    """The losses of a batch. Those without a weight are not computed."""

    weights: LossConfig
    place: Place
    surface_rays: int
    """Rays whose first surface the losses of normals look at, at most."""
    second_rays: int
    """Rays of a second pass, the first of these."""
    first_rule: str = "median"
    """How a first surface is found, see `first_surface`."""
    turns_solid: bool = False
    """Whether the rule "share" takes over from `SETTLED` on."""
    precision: str = "float32"
    pose_sigma: tuple[float, ...] = (1.0,) * 6
    """Standard deviations of a pose's correction [scene unit, rad]."""
    pose_prior: float = 0.0

    @classmethod
    def of(cls, config: Config, facts: SceneFacts, place: Place) -> "Objective":
        """As configured, for one scene."""
        normalisation = facts.normalisation
        weights = config.losses.in_scene(bounded=normalisation.bounded)
        sigma = config.poses.sigma(normalisation.scale)
        surface, precision = config.surface, config.train.precision
        first = surface.first_in_scene(bounded=normalisation.bounded)
        solid = surface.turns_solid(bounded=normalisation.bounded)
        rays = surface.normal_factor * surface.rays
        return cls(weights, place, rays, surface.rays, first, solid, precision, sigma, config.poses.prior)

    def __call__(
        self, model: Model, batch: Batch, sample_key: PRNGKeyArray, background_key: PRNGKeyArray, progress: Float[Array, ""]
    ) -> tuple[Float[Array, ""], tuple[Terms, Float[Array, " n"], Surfaces]]:
        """The sum of all losses; each of them, the density of every sample, and first surfaces."""
        model = computed_in(self.precision, model)
        rays, terms = batch.rays, {}
        moving = followed(rays, model.poses)  # poses follow the picture; where else the field is looked at is data
        found = model.sampler.sampled(batch, sample_key)
        cloud = cloud_of(moving, found.samples, space=self.place.space, footprint=found.footprint)
        rendered, density = _rendered(model, moving, found.samples, cloud)
        if model.poses is not None and self.pose_prior:
            terms |= pose_term(model.poses / jnp.array(self.pose_sigma), self.pose_prior)
        if model.per_image is not None:
            rendered = rendered.exposed(model.log_gains[rays.view])
        background = jax.random.uniform(background_key, (rays.origins.shape[0], 3))
        terms |= photometric(
            rendered, batch.colour, background, batch.used, self.weights.charbonnier, model.per_image is not None
        )
        terms |= self.ray_terms(model, rendered, density, found, progress)
        by = lambda rule: find_surfaces(rendered.weights, found.samples, rays.radii, self.surface_rays, rule)  # noqa: E731
        surfaces = jax.lax.stop_gradient(Surfaces(by(self.first_rule), by("share")))
        if self.turns_solid:
            surfaces = surfaces.solid_where(progress >= SETTLED)
        terms |= surface_point_terms(model.field, rays, surfaces.first, self.weights, self.place, progress)
        return total(terms), (terms, jax.lax.stop_gradient(density), surfaces.of_rays(self.second_rays))

    def ray_terms(
        self, model: Model, rendered: Rendered, density: Float[Array, " n"], found: Sampled, progress: Float[Array, ""]
    ) -> Terms:
        """Losses of the weights along each ray, and the decay of the tables."""
        weights, terms = self.weights, {}
        if found.edges is not None:
            terms |= interlevel_term(found.edges, rendered.weights, found.levels, weights.interlevel)
        if weights.distortion:
            terms |= distortion_term(rendered, found.samples, weights.distortion)
        if weights.hollowness:
            weight = weights.hollowness * late(progress, start=weights.hollow_from)
            terms |= hollowness_term(rendered, density, found.samples, weight)
        if weights.fog:
            terms |= fog_term(rendered, found.samples, weights.fog * (progress >= FOGGY))
        if weights.decay:
            terms |= decay_term(model, weights.decay)
        return terms


def _rendered(model: Model, rays: Rays, samples: RaySamples, cloud: Cloud) -> tuple[Rendered, Float[Array, " n"]]:
    return render(model.field, rays, samples, replace(cloud, followed=model.poses is not None), model.caster)


def photometric(
    rendered: Rendered,
    colour: Float[Array, "rays 4"],
    background: Float[Array, "rays 3"],
    used: Bool[Array, " rays"],
    width: float,
    clips: bool = False,
) -> Terms:
    """Charbonnier loss and mean square error of the rays that were rendered.

    Args:
        clips: whether exposure differs, so that a saturated channel tells no more than the least light that it had.
    """
    error = rendered.over(background) - over(colour, background)
    if clips:
        error = jnp.where((colour[:, :3] > SATURATED) & (colour[:, 3:] > SATURATED), jnp.minimum(error, 0.0), error)
    count = jnp.maximum(jnp.sum(used), 1)
    share = used[:, None] / (3 * count)
    return {"photometric": jnp.sum(losses.charbonnier(error, width) * share), "mse": jnp.sum(error * error * share)}


def surface_point_terms(
    field: Field, rays: Rays, surface: Surface, weights: LossConfig, place: Place, progress: Float[Array, ""]
) -> Terms:
    """Orientation and predicted normals at the first surface of each ray, as far as they have a weight.

    The reflection shows early where predicted normals are wrong, and late that they are right: then the density may follow them.
    """
    last = weights.density_normals if weights.last_density_normals is None else weights.last_density_normals
    alike = (weights.predicted_normals or weights.density_normals or last) and field.appearance.predicts_normals
    if not (weights.orientation or alike):
        return {}
    _, material, normals = field.with_normals(place.of(rays, surface))
    viewdirs = rays.viewdirs[surface.ray].T
    facing, terms = losses.orientation(normals, viewdirs), {}
    if field.appearance.predicts_normals:
        facing = facing + losses.orientation(material.normals_pred, viewdirs)
        held, held_pred = jax.lax.stop_gradient((normals, material.normals_pred))
        follow = between(progress, first=weights.density_normals, last=last, over=FOLLOWING)
        terms["predicted_normals"] = surface.mean(
            weights.predicted_normals * losses.normal_difference(held, material.normals_pred)
            + follow * losses.normal_difference(normals, held_pred)
        )
    return terms | {"orientation": weights.orientation * surface.mean(facing)}


def interlevel_term(
    sdist: Float[Array, "rays edges"], weights: Float[Array, "rays n"], levels: tuple[Level, ...], weight: float
) -> Terms:
    """Proposals follow the final level's blurred weights."""
    total = jnp.zeros(())
    for (edges, proposed), blur in zip(levels, BLURS, strict=True):
        target = resample_blurred(edges, sdist, jax.lax.stop_gradient(weights), blur)
        total = total + jnp.mean(losses.interlevel(target, proposed))
    return {"interlevel": weight * total}


def distortion_term(rendered: Rendered, samples: RaySamples, weight: float) -> Terms:
    """Distortion of the weights, by distance along the ray."""
    middle, length = samples.padded(samples.t), samples.padded(samples.length)
    return {"distortion": weight * jnp.mean(losses.distortion(rendered.weights, middle, length))}


def hollowness_term(
    rendered: Rendered, density: Float[Array, " n"], samples: RaySamples, weight: float | Float[Array, ""]
) -> Terms:
    """What is solid gets no thinner behind its surface."""
    return {"hollowness": weight * jnp.mean(losses.hollowness(rendered.weights, samples.padded(density)))}


def fog_term(rendered: Rendered, samples: RaySamples, weight: float | Float[Array, ""]) -> Terms:
    """Nothing is before a surface."""
    middle, length = samples.padded(samples.t), samples.padded(samples.length)
    slot = first_surface(jax.lax.stop_gradient(rendered.weights), length > 0, "share")
    return {"fog": weight * jnp.mean(losses.fog(rendered.weights, middle, length, slot))}


def pose_term(corrections: Float[Array, "views 6"], weight: float) -> Terms:
    """Corrections of poses, in standard deviations of the given poses, stay near zero: half their mean square per view."""
    return {"poses": weight / 2 * jnp.mean(jnp.sum(corrections * corrections, -1))}


def decay_term(model: Model, weight: float) -> Terms:
    """Mean square of the tables' values, summed over levels, those of the sampler included."""
    encodings = [model.field.encoding, *model.sampler.encodings]
    return {"decay": weight * sum((encoding.decay() for encoding in encodings), jnp.zeros(()))}


def total(terms: Terms) -> Float[Array, ""]:
    """Sum of all terms but the mean square error, which is for the log."""
    return sum((value for name, value in terms.items() if name != "mse"), jnp.zeros(()))
