"""The second pass: the field around first surfaces and from many directions, and the regularisers there (paper section 4)."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from koala3d.reconstruct.config import SurfaceConfig
from koala3d.reconstruct.field.appearance import Material
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.field.parallax import places_on
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.surface import regularisers
from koala3d.reconstruct.surface.ball import ball_samples
from koala3d.reconstruct.surface.first_surface import Surfaces
from koala3d.reconstruct.surface.parts import at_object, bias_for_two_kinds
from koala3d.reconstruct.surface.place import Place

NEIGHBOURS = 3
"""Nearest directions in the graph of the total variation (supplement D)."""
PerPoint = dict[str, Float[Array, " n"]]


@dataclass(frozen=True)
class SecondPass:
    """The four regularisers as configured; those without a weight are not computed."""

    place: Place
    surface: SurfaceConfig

    def terms(
        self, field: Field, rays: Rays, surfaces: Surfaces, key: PRNGKeyArray, bias: float | Float[Array, ""]
    ) -> dict[str, Float[Array, ""]]:
        """Mean of each regulariser over the surface points, each counted by its weight along its ray.

        Args:
            bias: factor on the Lambertian bias of the object, in [0, 1]; what is around it is mostly matte, and has it whole.
        """
        surface, wanted = surfaces.first, self.surface
        count, reach = surface.ray.shape[0], wanted.reach * surface.radius
        directions, radii = ball_samples(key, count, wanted)
        cloud = self.place.of(rays, surface)
        if wanted.density or wanted.normal:
            cloud = cloud.joined(self.place.of(rays, surface, directions * (radii[:, None] * reach[:, None, None])))
        density, material, normals = field.with_normals(cloud, shown=count)
        normal = normals[:, :count]
        published_bias = wanted.bias and wanted.bias_form == "published" and field.appearance.has_diffuse
        per_point: PerPoint = {}
        if wanted.density or wanted.normal:
            per_point |= self._around(density[count:], normals[:, count:], directions, normal, reach)
        if wanted.variation or published_bias:
            light, places = Lit.on(rays, surface.t, surface.ray), places_on(rays, surface.t, surface.ray)
            per_point |= self._over_directions(field, material, directions, normal, light, places)
        terms = {name: surface.mean(value) for name, value in per_point.items()}
        if wanted.bias and wanted.bias_form == "kinds" and field.appearance.has_diffuse:
            two_kinds = bias_for_two_kinds(field, self.place, rays, surfaces.solid)
            factor = at_object(self.place, rays, surfaces.solid, bias)
            terms["lambertian_bias"] = wanted.bias * surfaces.solid.mean(two_kinds * factor)
        return terms

    def _around(
        self,
        density: Float[Array, " n_around"],
        normals: Float[Array, "3 n_around"],
        directions: Float[Array, "n around 3"],
        normal: Float[Array, "3 n"],
        reach: Float[Array, " n"],
    ) -> PerPoint:
        """L_d and L_n: density and normals of the ball's samples."""
        alone = density.reshape(directions.shape[:2])
        around = normals.T.reshape(directions.shape)
        smoothness = regularisers.density_smoothness(alone, directions, normal.T, reach, self.surface.density_form)
        return {
            "density_smoothness": self.surface.density * smoothness,
            "normal_consistency": self.surface.normal * regularisers.normal_consistency(around, normal.T),
        }

    def _over_directions(
        self,
        field: Field,
        material: Material,
        directions: Float[Array, "n around 3"],
        normal: Float[Array, "3 n"],
        light: Lit | None,
        places: Float[Array, "3 n"],
    ) -> PerPoint:
        """L_b and L_s: the reflected colour over the visible hemisphere; all of the colour where nothing is diffuse.

        Lamps that move about the object stay where they were for the ray's picture.
        """
        outward = jax.lax.stop_gradient(normal.T)
        facing = jnp.sum(directions * outward[:, None], -1, keepdims=True)
        inward = jnp.where(facing > 0, -directions, directions)  # light travels into the surface: d . n <= 0
        repeated = Material.unstacked(jnp.repeat(material.stacked(), directions.shape[1], axis=1))
        light = None if light is None else light.repeated(directions.shape[1])
        places = jnp.repeat(places, directions.shape[1], axis=1)
        shading = field.shade(repeated, inward.reshape(-1, 3).T, light=light, places=places)
        diffuse = field.appearance.has_diffuse
        colour = (shading.specular if diffuse else shading.rgb).T.reshape(directions.shape)
        likeness = regularisers.direction_likeness(inward)
        variation = regularisers.specular_variation(colour, likeness, NEIGHBOURS)
        terms = {"specular_variation": self.surface.variation * variation}
        if diffuse and self.surface.bias and self.surface.bias_form == "published":
            terms["lambertian_bias"] = self.surface.bias * regularisers.lambertian_bias(colour)
        return terms
