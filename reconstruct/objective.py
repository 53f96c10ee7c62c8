"""What training minimises: the photometric loss, the losses taken over, and the four surface regularisers."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from reconstruct import losses
from reconstruct.cloud import Cloud, points_on_rays
from reconstruct.config import Config, SurfaceConfig
from reconstruct.field import Field, Material
from reconstruct.model import Model, Rendered, cloud_of
from reconstruct.rays import Rays
from reconstruct.sampling.proposal import Proposal
from reconstruct.sampling.samples import RaySamples
from reconstruct.stepfun import resample_blurred
from reconstruct.surface import Surface, find_surfaces, random_rotations, shell_radii, sphere_directions

Terms = dict[str, Float[Array, ""]]

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
    target = colour[:, :3] * colour[:, 3:] + (1 - colour[:, 3:]) * background
    error = rendered.over(background) - target
    count = jnp.maximum(jnp.sum(used), 1)
    share = used[:, None] / (3 * count)
    return {"photometric": jnp.sum(losses.charbonnier(error, width) * share), "mse": jnp.sum(error * error * share)}


def surface_point_terms(field: Field, rays: Rays, surface: Surface, config: Config, bounded: bool) -> Terms:
    """Orientation and predicted normals at the first surface of each ray."""
    cloud = points_on_rays(rays, surface.ray, surface.t, bounded)
    _, material, normals = field.with_normals(cloud)
    viewdirs = rays.viewdirs[surface.ray].T
    count = jnp.maximum(jnp.sum(surface.weight > 0), 1)
    mean = lambda v: jnp.sum(surface.weight * v) / count  # noqa: E731
    facing = losses.orientation(normals, viewdirs) + losses.orientation(material.normals_pred, viewdirs)
    return {
        "orientation": config.losses.orientation * mean(facing),
        "predicted_normals": config.losses.predicted_normals * mean(losses.normal_difference(normals, material.normals_pred)),
    }


def second_pass_terms(
    field: Field, rays: Rays, surface: Surface, key: PRNGKeyArray, config: SurfaceConfig, bounded: bool
) -> Terms:
    """The four regularisers on a ball of samples around each surface point (paper section 4, supplement A-D)."""
    count, rays_used = config.samples, surface.ray.shape[0]
    rotation = random_rotations(key, rays_used)
    sphere = jnp.einsum("rxy,ny->rnx", rotation, jnp.asarray(sphere_directions(count, config.kappa), jnp.float32))
    centre = points_on_rays(rays, surface.ray, surface.t, bounded)
    radius = surface.radius
    offsets = sphere * jnp.asarray(shell_radii(count), jnp.float32)[:, None] * radius[:, None, None]
    around = Cloud((centre.points.T[:, None] + offsets).reshape(-1, 3).T, None, bounded)

    _, material, normal = field.with_normals(centre)
    density, _, normals = field.with_normals(around)
    normals = normals.T.reshape(rays_used, count, 3)
    outward = jax.lax.stop_gradient(normal.T)
    facing = jnp.sum(sphere * outward[:, None], -1, keepdims=True)
    directions = jnp.where(facing > 0, -sphere, sphere)  # light travels into the surface: d . n <= 0
    repeated = Material.unstacked(jnp.repeat(material.stacked(), count, axis=1))
    specular = field.shade(repeated, directions.reshape(-1, 3).T).specular.T.reshape(rays_used, count, 3)

    per_ray = {
        "density_smoothness": config.density
        * losses.density_smoothness(density.reshape(rays_used, count), sphere, normal.T, radius, config.density_form),
        "normal_consistency": config.normal * losses.normal_consistency(normals, normal.T),
        "lambertian_bias": config.bias * losses.lambertian_bias(specular),
        "specular_variation": config.variation * losses.specular_variation(specular, directions, config.neighbours),
    }
    used = jnp.maximum(jnp.sum(surface.weight > 0), 1)
    return {name: jnp.sum(surface.weight * value) / used for name, value in per_ray.items()}


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


def decay_term(model: Model, weight: float) -> Terms:
    """Mean square of the tables' values, summed over levels (and over proposals, where there are any)."""
    encodings = [model.field.encoding, *(proposal.encoding for proposal in model.proposals)]
    return {"decay": weight * sum((encoding.decay() for encoding in encodings), jnp.zeros(()))}


def proposal_density(
    proposal: Proposal, rays: Rays, tdist: Float[Array, "rays edges"], *, bounded: bool, turn: Float[Array, " rays"] | None
) -> Float[Array, "rays edges-1"]:
    """Densities of a proposal in the given intervals."""
    cloud = cloud_of(rays, RaySamples.from_edges(tdist), bounded=bounded, turn=turn)
    return proposal.density(cloud).reshape(tdist.shape[0], -1)


def surfaces_of(rendered: Rendered, samples: RaySamples, rays: Rays, count: int) -> Surface:
    """First surfaces of up to `count` of the rendered rays, as data."""
    return jax.lax.stop_gradient(find_surfaces(rendered.weights, samples, rays.radii, count))


def total(terms: Terms) -> Float[Array, ""]:
    """Sum of all terms but the mean square error, which is there to be looked at."""
    return sum((value for name, value in terms.items() if name != "mse"), jnp.zeros(()))
