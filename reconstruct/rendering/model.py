"""A field, its proposals, and how rays are rendered with them."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from reconstruct.config import Config
from reconstruct.field.appearance import Material
from reconstruct.field.cloud import Cloud, gaussians_in_frustums, hexagons_in_frustums, points_on_rays
from reconstruct.field.field import Field
from reconstruct.numerics.safe import linear_from_srgb, srgb_from_linear
from reconstruct.rendering.volume import composite, sample_weights
from reconstruct.sampling.proposal import Proposal
from reconstruct.sampling.samples import RaySamples
from reconstruct.scene.rays import Rays


class Model(eqx.Module):
    """What is learned."""

    field: Field
    proposals: tuple[Proposal, ...]
    per_image: Float[Array, "views gains"] | None = None
    """Logarithm of each training view's gain, one for all colours or one for each; counted from the views' mean."""
    poses: Float[Array, "views 6"] | None = None
    """Correction of each training view's pose; see `twists`."""

    @classmethod
    def create(cls, key: PRNGKeyArray, config: Config, views: int = 0) -> "Model":
        """Fresh weights; proposals, and gains and poses of `views` training views, only where the configuration wants them."""
        field_key, *keys = jax.random.split(key, 1 + len(config.sampler.proposal_finest))
        wanted = zip(keys, config.sampler.proposal_finest, strict=True) if config.sampler.kind == "proposal" else ()
        sampler, bias = config.sampler, config.field.density_bias
        proposals = tuple(Proposal.create(k, config.encoding, finest, bias, width=sampler.proposal_width, depth=sampler.proposal_depth)
                          for k, finest in wanted)  # fmt: skip
        gains = {"none": None, "exposure": jnp.zeros((views, 1)), "colour": jnp.zeros((views, 3))}[config.train.per_image]
        poses = jnp.zeros((views, 6)) if config.poses.enabled else None
        return cls(Field.create(field_key, config.encoding, config.field), proposals, gains, poses)


class Rendered(eqx.Module):
    """Rays as the model sees them. Foreground only: the background receives 1 - opacity."""

    rgb: Float[Array, "rays 3"]
    """sRGB, premultiplied with opacity."""
    opacity: Float[Array, " rays"]
    diffuse: Float[Array, "rays 3"]
    """Linear, premultiplied."""
    specular: Float[Array, "rays 3"]
    """Linear, premultiplied, tint included."""
    roughness: Float[Array, " rays"]
    """Premultiplied."""
    normals_pred: Float[Array, "rays 3"]
    """Sum of weighted predicted normals: not unit where samples disagree."""
    depth: Float[Array, " rays"]
    """Mean t of the visible samples (z distance) [scene unit]; zero where nothing is seen."""
    weights: Float[Array, "rays slots"]

    def over(self, background: Float[Array, "*rays 3"]) -> Float[Array, "rays 3"]:
        """sRGB colour over a background."""
        return self.rgb + (1 - self.opacity[:, None]) * background

    def exposed(self, log_gain: Float[Array, "rays gains"]) -> "Rendered":
        """The same with its light multiplied, as a camera with another exposure or white balance would see it."""
        opacity = jnp.maximum(self.opacity[:, None], 1e-6)
        light = linear_from_srgb(jnp.clip(self.rgb / opacity, 0.0, 1.0)) * jnp.exp(log_gain)
        return eqx.tree_at(lambda r: r.rgb, self, srgb_from_linear(light) * opacity)


class Footprint(eqx.Module):
    """What stands for the conical frustum of a sample."""

    kind: str = eqx.field(static=True, default="point")
    """"point", "gaussian" (Mip-NeRF) or "hexagon" (Zip-NeRF)."""
    turn: Float[Array, " rays"] | None = None
    """Angle by which each ray's hexagons are turned about it [rad]."""


def cloud_of(rays: Rays, samples: RaySamples, *, bounded: bool, footprint: Footprint) -> Cloud:
    """Places of the samples."""
    if footprint.kind == "point":
        return points_on_rays(rays, samples.ray, samples.t, bounded)
    if footprint.turn is None:
        return gaussians_in_frustums(rays, samples.ray, samples.t, samples.length / 2, bounded)
    centre, half = samples.padded(samples.t), samples.padded(samples.length) / 2
    edges = jnp.concatenate([centre - half, centre[:, -1:] + half[:, -1:]], -1)
    return hexagons_in_frustums(rays, edges, footprint.turn, bounded)


def render(field: Field, rays: Rays, samples: RaySamples, cloud: Cloud, *, deferred: bool) -> tuple[Rendered, Float[Array, " n"]]:
    """Composite the samples of each ray.

    Args:
        deferred: composite the material first and shade once per ray, instead of shading each sample.

    Returns:
        The rays, and the density of every sample [1 / scene unit].
    """
    apart = jax.lax.optimization_barrier  # one stage is not computed again inside the loops of the next
    density, material = apart(field(cloud))
    weights = apart(sample_weights(density, samples, rays.speed))
    flat = apart(samples.packed(weights))
    channels = jnp.concatenate([jnp.ones_like(flat)[None], samples.t[None], material.stacked()])
    if not deferred:
        directions = rays.viewdirs.at[samples.ray].get(mode="promise_in_bounds").T
        shading = apart(field.shade(material, directions))
        channels = jnp.concatenate([channels, shading.rgb, shading.specular])
    sums = apart(composite(channels, flat, samples))
    opacity = sums[:, 0]
    mean = sums / jnp.maximum(opacity, 1e-6)[:, None]
    if deferred:
        shading = apart(field.shade(Material.unstacked(apart(mean[:, 2:].T)), rays.viewdirs.T))
        rgb, specular = shading.rgb.T * opacity[:, None], shading.specular.T * opacity[:, None]
    else:
        rgb, specular = sums[:, -6:-3], sums[:, -3:]
    rendered = Rendered(rgb=rgb, opacity=opacity, diffuse=sums[:, 2:5], specular=specular, roughness=sums[:, 8],
                        normals_pred=sums[:, 9:12], depth=mean[:, 1], weights=weights)  # fmt: skip
    return apart((rendered, density))
