"""A model, and how rays are rendered with it."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray
from numpy.typing import NDArray

from koala3d.reconstruct.config import Config
from koala3d.reconstruct.field.appearance import Material, Start
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.field.outline import Outline
from koala3d.reconstruct.field.parallax import Parallax, places_on
from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.numerics.safe import linear_from_srgb, srgb_from_linear
from koala3d.reconstruct.rendering.compositing import composited, lost_at, packed_depth, values_of
from koala3d.reconstruct.sampling.create import create
from koala3d.reconstruct.sampling.sampler import Sampler
from koala3d.reconstruct.sampling.samples import RaySamples
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.twists import Session, Twists

HELD = ("blur", "bounds", "grid", "outline", "spread", "start")
"""Names of the parts of a model that no gradient goes to: they follow a schedule, what a training meets, masks, or the scene."""


class Model(eqx.Module):
    """All that it takes to look at a scene: what was learned, and the sampler's own state."""

    field: Field
    sampler: Sampler
    per_image: Float[Array, "views gains"] | None = None
    """Logarithm of each training view's gain, one for all colours or one for each; counted from the views' mean."""
    poses: Float[Array, "views 6"] | None = None
    """Correction of each training view's pose; see `twists`."""
    session: Session | None = None
    """Correction of the pose of an object that was turned over, for all views of the second session."""

    @classmethod
    def create(
        cls,
        key: PRNGKeyArray,
        config: Config,
        facts: SceneFacts,
        views: int = 0,
        possible: NDArray[Any] | None = None,
        hull: NDArray[Any] | None = None,
    ) -> "Model":
        """Fresh weights; gains and poses of `views` training views only where the configuration wants them.

        Args:
            possible: cells that can hold anything, see `Sampler.possible_cells`.
            hull: see `hull_distance`.
        """
        field_key = jax.random.split(key, 1 + len(config.sampler.proposal_finest))[0]
        start = Start(facts.towards, facts.light, Parallax.of(config.light))
        outline = Outline.of(hull) if config.field.matter == "solid" else None
        field = Field.create(field_key, config.encoding, config.field, start=start, outline=outline)
        sampler = create(key, config, facts, possible, config.field.density_bias)
        gains = first_gains(config, facts, views)
        poses = jnp.zeros((views, 6)) if config.poses.enabled is True else None
        return cls(field, sampler, gains, poses, facts.free_session)

    @property
    def twists(self) -> Twists | None:
        """Corrections of the training views' poses, all in all; None where poses are as given."""
        if self.session is None or self.poses is None:
            return self.poses if self.session is None else self.session.twists
        return self.poses + self.session.twists

    @property
    def log_gains(self) -> Float[Array, "views gains"]:
        """`per_image` counted from its mean: what the views' light is multiplied by."""
        assert self.per_image is not None
        return self.per_image - jnp.mean(self.per_image, 0)

    def blurred(self, blur: Float[Array, ""]) -> "Model":
        """The same with every sample as wide as `blur` [scene unit]."""
        return eqx.tree_at(lambda m: m.field.encoding.blur, self, blur)

    def freed(self, gain: Float[Array, ""]) -> "Model":
        """The same whose network adds at least so much to the outline that the density began with."""
        if self.field.outline is None:
            return self
        return eqx.tree_at(lambda m: m.field.outline.gain, self, jnp.maximum(self.field.outline.gain, gain))

    def split(self) -> tuple["Model", "Model"]:
        """What is learned, and the rest (see `HELD`); `eqx.combine` joins them."""

        def is_learned(path: tuple[Any, ...], leaf: Any) -> bool:
            return eqx.is_inexact_array(leaf) and not any(getattr(part, "name", "") in HELD for part in path)

        return eqx.partition(self, jax.tree.map_with_path(is_learned, self))


def first_gains(config: Config, facts: SceneFacts, views: int) -> Float[Array, "views gains"] | None:
    """Log gains of training views before the first step: as measured, else none at all. None where no gains are learned."""
    count = {"exposure": 1, "colour": 3}.get(config.train.per_image)
    if count is None:
        return None
    if facts.log_gains is None:
        return jnp.zeros((views, count))
    measured = jnp.asarray(facts.log_gains, jnp.float32)
    return measured if count == 3 else jnp.mean(measured, -1, keepdims=True)


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


def render(field: Field, rays: Rays, samples: RaySamples, cloud: Cloud) -> tuple[Rendered, Float[Array, " n"]]:
    """Composite the samples of each ray, and shade them as the field is shaded.

    Returns:
        The rays, and the density of every sample [1 / scene unit].
    """
    density, material = barrier(field(cloud))
    depth = barrier(packed_depth(field, density, samples, rays.speed))
    values = values_of(field, material, rays, samples)
    before = jnp.where(samples.slot > 0, jnp.roll(samples.t, 1), samples.t)
    weights, sums = barrier(composited(depth, values, replace(samples, t=lost_at(samples.t, before, solid=field.solid))))
    return barrier((seen(field, rays, sums, weights), density))


def seen(field: Field, rays: Rays, sums: Float[Array, "channels rays"], weights: Float[Array, "rays slots"]) -> Rendered:
    """Rays whose samples are composited, shaded where the field shades rays.

    Args:
        sums: of weights, of t and of `values_of`.
    """
    opacity = sums[0]
    mean = sums / jnp.maximum(opacity, 1e-6)
    diffuse = sums[2:5]
    if field.deferred:
        light = Lit.on(rays, mean[1])
        material = field.under_lamps(Material.unstacked(barrier(mean[2:])), light)
        places = places_on(rays, mean[1]) if field.appearance.parallax is not None else None
        shading = barrier(field.shade(material, rays.viewdirs.T, light=light, places=places))
        rgb, specular = shading.rgb * opacity, shading.specular * opacity
        diffuse = diffuse if light is None else material.diffuse * opacity
    else:
        rgb, specular = sums[-6:-3], sums[-3:]
    return Rendered(
        rgb=rgb.T,
        opacity=opacity,
        diffuse=diffuse.T,
        specular=specular.T,
        roughness=sums[8],
        normals_pred=sums[9:12].T,
        depth=mean[1],
        weights=weights,
    )
