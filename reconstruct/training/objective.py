"""What training minimises: the photometric loss, the losses taken over, and the four surface regularisers."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from reconstruct.config import LossConfig, SurfaceConfig
from reconstruct.field.appearance import Material
from reconstruct.field.cloud import Cloud, points_on_rays
from reconstruct.field.field import Field
from reconstruct.numerics.stepfun import resample_blurred
from reconstruct.rendering.model import Footprint, Model, Rendered, cloud_of
from reconstruct.sampling.proposal import Proposal
from reconstruct.sampling.samples import RaySamples
from reconstruct.scene.rays import Rays, over
from reconstruct.surface import losses
from reconstruct.surface.sphere import HALF_WIDTH, Surface, ball_samples, find_surfaces

Terms = dict[str, Float[Array, ""]]
PerRay = dict[str, Float[Array, " _"]]

BLURS = (0.03, 0.003)
"""Half-widths of the interlevel loss's blur, in normalised distance (Zip-NeRF)."""


def photometric(
    rendered: Rendered,
    colour: Float[Array, "rays 4"],
    background: Float[Array, "rays 3"],
    used: Bool[Array, " rays"],
    width: float,
) -> Terms:
    """Charbonnier loss and mean square error of the rays that were rendered."""
    error = rendered.over(background) - over(colour, background)
    count = jnp.maximum(jnp.sum(used), 1)
    share = used[:, None] / (3 * count)
    return {"photometric": jnp.sum(losses.charbonnier(error, width) * share), "mse": jnp.sum(error * error * share)}


@dataclass(frozen=True)
class Place:
    """How surface points become places in the field: in a bounded scene or not, as points or as Gaussians."""

    bounded: bool
    extended: bool = False
    """Whether each stands for an isotropic Gaussian as wide as its pixel's cone, which looks the same from all sides."""

    def of(self, rays: Rays, surface: Surface, offsets: Float[Array, "n around 3"] | None = None) -> Cloud:
        """The surface points, or `offsets` [scene unit] around each of them, point after point."""
        points = points_on_rays(rays, surface.ray, surface.t, self.bounded).points
        scale = surface.radius / HALF_WIDTH if self.extended else None
        if offsets is not None:
            points = (points.T[:, None] + offsets).reshape(-1, 3).T
            scale = None if scale is None else jnp.repeat(scale, offsets.shape[1])
        return Cloud(points, scale, self.bounded)


def surface_point_terms(field: Field, rays: Rays, surface: Surface, config: LossConfig, place: Place) -> Terms:
    """Orientation and predicted normals at the first surface of each ray, as far as they have a weight."""
    alike = (config.predicted_normals or config.density_normals) and field.appearance.predicts_normals
    if not (config.orientation or alike):
        return {}
    _, material, normals = field.with_normals(place.of(rays, surface))
    viewdirs = rays.viewdirs[surface.ray].T
    count = jnp.maximum(jnp.sum(surface.weight > 0), 1)
    mean = lambda v: jnp.sum(surface.weight * v) / count  # noqa: E731
    facing, terms = losses.orientation(normals, viewdirs), {}
    if field.appearance.predicts_normals:
        facing = facing + losses.orientation(material.normals_pred, viewdirs)
        held, still = jax.lax.stop_gradient((normals, material.normals_pred))
        terms["predicted_normals"] = mean(
            config.predicted_normals * losses.normal_difference(held, material.normals_pred)
            + config.density_normals * losses.normal_difference(normals, still)
        )
    return terms | {"orientation": config.orientation * mean(facing)}


def second_pass_terms(
    field: Field, rays: Rays, surface: Surface, key: PRNGKeyArray, config: SurfaceConfig, place: Place
) -> Terms:
    """Those of the four regularisers that have a weight, on a ball of samples around each surface point (section 4, A-D)."""
    directions, radii = ball_samples(key, surface.ray.shape[0], config.samples, config.kappa, config.sampling)
    _, material, normal = field.with_normals(place.of(rays, surface))
    per_ray = {}
    if config.density or config.normal:
        reach = config.reach * surface.radius
        offsets = directions * (radii[:, None] * reach[:, None, None])
        around = field.with_normals(place.of(rays, surface, offsets))
        per_ray |= _spatial_terms(around, directions, normal, reach, config)
    if config.variation or (config.bias and field.appearance.has_diffuse):
        per_ray |= _directional_terms(field, material, directions, normal, config)
    used = jnp.maximum(jnp.sum(surface.weight > 0), 1)
    return {name: jnp.sum(surface.weight * value) / used for name, value in per_ray.items()}


def _spatial_terms(around, directions: Float[Array, "n around 3"], normal: Float[Array, "3 n"], radius, config) -> PerRay:
    """Density smoothness and normal consistency of each surface point."""
    density, _, normals = around
    normals = normals.T.reshape(directions.shape)
    smoothness = losses.density_smoothness(
        density.reshape(directions.shape[:2]), directions, normal.T, radius, config.density_form
    )
    return {
        "density_smoothness": config.density * smoothness,
        "normal_consistency": config.normal * losses.normal_consistency(normals, normal.T),
    }


def _directional_terms(
    field: Field, material: Material, directions: Float[Array, "n around 3"], normal: Float[Array, "3 n"], config: SurfaceConfig
) -> PerRay:
    """Lambertian bias and total variation of each surface point; of the colour itself where nothing is diffuse."""
    outward = jax.lax.stop_gradient(normal.T)
    facing = jnp.sum(directions * outward[:, None], -1, keepdims=True)
    inward = jnp.where(facing > 0, -directions, directions)  # light travels into the surface: d . n <= 0
    repeated = Material.unstacked(jnp.repeat(material.stacked(), directions.shape[1], axis=1))
    shading, diffuse = field.shade(repeated, inward.reshape(-1, 3).T), field.appearance.has_diffuse
    colour = (shading.specular if diffuse else shading.rgb).T.reshape(directions.shape)
    likeness = losses.direction_likeness(inward, config.neighbour_form)
    terms = {"specular_variation": config.variation * losses.specular_variation(colour, likeness, config.neighbours)}
    if diffuse and config.bias:
        terms["lambertian_bias"] = config.bias * losses.lambertian_bias(colour)
    return terms


def interlevel_terms(sdist: Float[Array, "rays edges"], weights: Float[Array, "rays n"], levels: list, weight: float) -> Terms:
    """Proposals follow the final level's blurred weights."""
    total = jnp.zeros(())
    for (edges, proposed), blur in zip(levels, BLURS, strict=True):
        target = resample_blurred(edges, sdist, jax.lax.stop_gradient(weights), blur)
        total = total + jnp.mean(losses.interlevel(target, proposed))
    return {"interlevel": weight * total}


def distortion_term(rendered: Rendered, samples: RaySamples, scale: Float[Array, ""], weight: float) -> Terms:
    """Distortion of the weights, with distances divided by `scale` (the depth of what is seen)."""
    middle, length = samples.padded(samples.t) / scale, samples.padded(samples.length) / scale
    return {"distortion": weight * jnp.mean(losses.distortion(rendered.weights, middle, length))}


def hollowness_term(
    rendered: Rendered, density: Float[Array, " n"], samples: RaySamples, weight: float | Float[Array, ""]
) -> Terms:
    """What is solid gets no thinner behind its surface."""
    return {"hollowness": weight * jnp.mean(losses.hollowness(rendered.weights, samples.padded(density)))}


def pose_term(corrections: Float[Array, "views 6"], weight: float) -> Terms:
    """Corrections of poses, in standard deviations of the given poses, stay near zero: half their mean square per view."""
    return {"poses": weight / 2 * jnp.mean(jnp.sum(corrections * corrections, -1))}


def decay_term(model: Model, weight: float) -> Terms:
    """Mean square of the tables' values, summed over levels (and over proposals, where there are any)."""
    encodings = [model.field.encoding, *(proposal.encoding for proposal in model.proposals)]
    return {"decay": weight * sum((encoding.decay() for encoding in encodings), jnp.zeros(()))}


def proposal_density(
    proposal: Proposal, rays: Rays, tdist: Float[Array, "rays edges"], *, bounded: bool, footprint: Footprint
) -> Float[Array, "rays edges-1"]:
    """Densities of a proposal in the given intervals."""
    cloud = cloud_of(rays, RaySamples.from_edges(tdist), bounded=bounded, footprint=footprint)
    return proposal.density(cloud).reshape(tdist.shape[0], -1)


def surfaces_of(rendered: Rendered, samples: RaySamples, rays: Rays, count: int) -> Surface:
    """First surfaces of up to `count` of the rendered rays, as data."""
    return jax.lax.stop_gradient(find_surfaces(rendered.weights, samples, rays.radii, count))


def total(terms: Terms) -> Float[Array, ""]:
    """Sum of all terms but the mean square error, which is there to be looked at."""
    return sum((value for name, value in terms.items() if name != "mse"), jnp.zeros(()))
