"""What training minimises: the losses of rendered rays, and those at their first surfaces."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from koala3d.reconstruct.config import Config, LossConfig
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.numerics.stepfun import resample_blurred
from koala3d.reconstruct.numerics.volume import SPENT, sum_before
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
from koala3d.reconstruct.training.schedule import Schedule

Terms = dict[str, Float[Array, ""]]

LIT = "lit"
"""Samples of a ray that light reaches, a figure beside the losses."""
FIGURES = ("mse", LIT)
"""Terms that are no losses."""
SATURATED = 254.5 / 255
"""sRGB from which a channel of eight bits is clipped."""
POSE_WIDTH = 1e-3
"""Width of the photometric loss at most, where poses are learned: small errors tell where a camera stood."""
INTERLEVEL = 0.01
"""Weight with which proposals follow the final level (Zip-NeRF)."""
POSE_PRIOR = 1e-5
"""Weight of the squared corrections of poses, in standard deviations, halved."""
BLURS = (0.03, 0.003)
"""Half-widths of the interlevel loss's blur, in normalised distance (Zip-NeRF)."""


@dataclass(frozen=True)
class Objective:
    """The losses of a batch. Those without a weight are not computed."""

    weights: LossConfig
    schedule: Schedule
    place: Place
    surface_rays: int
    """Rays whose first surface the losses of normals look at, at most."""
    second_rays: int
    """Rays of a second pass, the first of these."""
    pose_sigma: tuple[float, ...] = (1.0,) * 6
    """Standard deviations of a pose's correction [scene unit, rad]."""

    @classmethod
    def of(cls, config: Config, facts: SceneFacts, place: Place) -> "Objective":
        """As configured, for one scene."""
        surface, sigma = config.surface, config.poses.sigma(facts.normalisation.scale)
        return cls(config.losses, Schedule(config), place, surface.normal_factor * surface.rays, surface.rays, sigma)

    def __call__(
        self, model: Model, batch: Batch, sample_key: PRNGKeyArray, background_key: PRNGKeyArray, progress: Float[Array, ""]
    ) -> tuple[Float[Array, ""], tuple[Terms, Float[Array, " n"], Surfaces]]:
        """The sum of the losses of rays; each of them, the density of every sample, and first surfaces."""
        rays, terms = batch.rays, {}
        moving = followed(rays, model.twists)  # poses follow the picture; where else the field is looked at is data
        found = model.sampler.sampled(batch, sample_key)
        cloud = cloud_of(moving, found.samples, space=self.place.space, footprint=found.footprint)
        rendered, density = _rendered(model, moving, found.samples, cloud)
        if model.poses is not None:
            terms |= pose_term(model.poses / jnp.array(self.pose_sigma), POSE_PRIOR)
        if model.session is not None:
            terms |= {"session": pose_term(model.session.by[None], POSE_PRIOR)["poses"]}
        if model.per_image is not None:
            rendered = rendered.exposed(model.log_gains[rays.view])
        background = jax.random.uniform(background_key, (rays.origins.shape[0], 3))
        width = self.weights.width if model.twists is None else min(self.weights.width, POSE_WIDTH)
        terms |= photometric(rendered, batch.colour, background, batch.used, width, clips=model.per_image is not None)
        terms |= self.ray_terms(rendered, density, found, progress) | {LIT: lit(jax.lax.stop_gradient(rendered.weights), found)}
        surfaces = self.surfaces(rendered, found.samples, rays, progress, model.sampler.bounds.half_box)
        return total(terms), (terms, jax.lax.stop_gradient(density), surfaces)

    def at_surfaces(
        self, field: Field, rays: Rays, surfaces: Surfaces, progress: Float[Array, ""]
    ) -> tuple[Float[Array, ""], Terms]:
        """The sum of the losses at first surfaces, and each of them."""
        follow = self.schedule.density_normals(progress)
        terms = surface_point_terms(field, rays, surfaces.first, self.weights, self.place, follow)
        return total(terms), terms

    def surfaces(
        self,
        rendered: Rendered,
        samples: RaySamples,
        rays: Rays,
        progress: Float[Array, ""],
        half_box: Float[Array, " 3"] | None,
    ) -> Surfaces:
        """First surfaces as data, by both rules: which one shapes follow is the schedule's. `half_box`: as of `Bounds`."""
        by = lambda rule: find_surfaces(rendered.weights, samples, rays.radii, self.surface_rays, rule)  # noqa: E731
        solid, begins = jax.lax.stop_gradient(by("share")), self.schedule.config.schedule.share_from
        if not begins:
            return Surfaces(solid, solid)
        found = Surfaces(jax.lax.stop_gradient(by("median")), solid)
        if begins == 1:
            return found
        return found.settled(self.schedule.by_share(progress), self.place.in_box(rays, solid, half_box))

    def ray_terms(self, rendered: Rendered, density: Float[Array, " n"], found: Sampled, progress: Float[Array, ""]) -> Terms:
        """Losses of the weights along each ray."""
        weights, terms = self.weights, {}
        if found.edges is not None:
            terms |= interlevel_term(found.edges, rendered.weights, found.levels)
        if weights.distortion:
            terms |= distortion_term(rendered, found, weights.distortion)
        if weights.hollowness:
            terms |= hollowness_term(rendered, density, found, self.schedule.hollowness(progress))
        if weights.fog:
            terms |= fog_term(rendered, found, self.schedule.fog(progress))
        return terms


def _rendered(model: Model, rays: Rays, samples: RaySamples, cloud: Cloud) -> tuple[Rendered, Float[Array, " n"]]:
    return render(model.field, rays, samples, replace(cloud, followed=model.twists is not None))


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
        width: error below which the loss is quadratic.
        clips: whether exposure differs, so that a saturated channel tells no more than the least light that it had.
    """
    error = rendered.over(background) - over(colour, background)
    if clips:
        error = jnp.where((colour[:, :3] > SATURATED) & (colour[:, 3:] > SATURATED), jnp.minimum(error, 0.0), error)
    count = jnp.maximum(jnp.sum(used), 1)
    share = used[:, None] / (3 * count)
    return {"photometric": jnp.sum(losses.charbonnier(error, width) * share), "mse": jnp.sum(error * error * share)}


def surface_point_terms(
    field: Field, rays: Rays, surface: Surface, weights: LossConfig, place: Place, follow: float | Float[Array, ""]
) -> Terms:
    """Orientation and predicted normals at the first surface of each ray, if they have a weight.

    Args:
        follow: weight with which the density's normals follow the predicted ones, at this time.
    """
    alike = (
        weights.predicted_normals or weights.density_normals or weights.last_density_normals
    ) and field.appearance.predicts_normals
    if not (weights.orientation or alike):
        return {}
    _, material, normals = field.with_normals(place.of(rays, surface))
    viewdirs = rays.viewdirs[surface.ray].T
    facing, terms = losses.orientation(normals, viewdirs), {}
    if field.appearance.predicts_normals:
        facing = facing + losses.orientation(material.normals_pred, viewdirs)
        held, held_pred = jax.lax.stop_gradient((normals, material.normals_pred))
        terms["predicted_normals"] = surface.mean(
            weights.predicted_normals * losses.normal_difference(held, material.normals_pred)
            + follow * losses.normal_difference(normals, held_pred)
        )
    return terms | {"orientation": weights.orientation * surface.mean(facing)}


def interlevel_term(sdist: Float[Array, "rays edges"], weights: Float[Array, "rays n"], levels: tuple[Level, ...]) -> Terms:
    """Proposals follow the final level's blurred weights."""
    total = jnp.zeros(())
    for (edges, proposed), blur in zip(levels, BLURS, strict=True):
        target = resample_blurred(edges, sdist, jax.lax.stop_gradient(weights), blur)
        total = total + jnp.mean(losses.interlevel(target, proposed))
    return {"interlevel": INTERLEVEL * total}


def distortion_term(rendered: Rendered, found: Sampled, weight: float) -> Terms:
    """Distortion of the weights, by distance along the ray."""
    middle, length = found.samples.padded(found.samples.t), found.samples.padded(found.samples.length)
    return {"distortion": weight * _mean(losses.distortion(rendered.weights, middle, length), found)}


def hollowness_term(rendered: Rendered, density: Float[Array, " n"], found: Sampled, weight: float | Float[Array, ""]) -> Terms:
    """What is solid gets no thinner behind its surface."""
    return {"hollowness": weight * _mean(losses.hollowness(rendered.weights, found.samples.padded(density)), found)}


def fog_term(rendered: Rendered, found: Sampled, weight: float | Float[Array, ""]) -> Terms:
    """Nothing is before a surface."""
    middle, length = found.samples.padded(found.samples.t), found.samples.padded(found.samples.length)
    slot = first_surface(jax.lax.stop_gradient(rendered.weights), length > 0, "share")
    return {"fog": weight * _mean(losses.fog(rendered.weights, middle, length, slot), found)}


def _mean(values: Float[Array, " rays"], found: Sampled) -> Float[Array, ""]:
    """Mean over the rays that take part."""
    return jnp.sum(jnp.where(found.fits, values, 0.0)) / jnp.maximum(jnp.sum(found.fits), 1)


def pose_term(corrections: Float[Array, "views 6"], weight: float) -> Terms:
    """Corrections of poses, in standard deviations of the given poses, stay near zero: half their mean square per view."""
    return {"poses": weight / 2 * jnp.mean(jnp.sum(corrections * corrections, -1))}


def lit(weights: Float[Array, "rays slots"], found: Sampled) -> Float[Array, ""]:
    """How many samples of a ray light reaches, on average."""
    there = found.samples.padded(found.samples.length) > 0
    return _mean(jnp.sum(there & (sum_before(weights) < 1 - np.exp(-SPENT)), -1, dtype=jnp.float32), found)


def total(terms: Terms) -> Float[Array, ""]:
    """Sum of the losses."""
    return sum((value for name, value in terms.items() if name not in FIGURES), jnp.zeros(()))
