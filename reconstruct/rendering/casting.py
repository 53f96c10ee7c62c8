"""Reflected rays cast through the scene itself (after NeRF-Casting, Verbin et al. 2024): a mirror shows the table it stands on.

Where a ray is shaded once, on its composited material, one reflected ray leaves its surface. It is cut into steps, those in
occupied cells are evaluated as wide as the lobe of the material's roughness, and what is composited there is shaded in turn, by
the light from afar alone. Its light comes before the light from afar, as far as it is opaque.

No gradient goes to what is met. So the loop over the rays can stop when none is left, and the cost depends on how much mirrors
show. A mirror whose shape is still wrong does not change its neighbours either, which the cameras see themselves. Nor does a
gradient go through what is met to the mirror's normals.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.field.appearance import Material
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.field.near import Near, mirrored
from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.numerics.safe import normalise
from koala3d.reconstruct.rendering.front_to_back import Queue, composited
from koala3d.reconstruct.sampling.occupied_steps import OccupiedSteps
from koala3d.reconstruct.sampling.sampler import Sampler
from koala3d.reconstruct.sampling.samples import Footprint
from koala3d.reconstruct.scene.frustum import Frustum
from koala3d.reconstruct.scene.rays import Rays

LIFT = 2.5
"""Height above its surface, in cells of the grid, at which a reflected ray begins: before the cells of the surface itself."""
GRAZING = 0.2
"""Cosine to the normal below which that height is not reached, lest a grazing ray begin far away."""
CONFIDENT = 0.5
"""Opacity above which a ray has a surface."""
FAINT = 0.02
"""Tint below which a surface is no mirror."""
ROUGH = 0.05
"""Roughness up to which the light of what is met counts fully; at twice this, the light from afar counts alone."""
STEP = 32
"""Numbers of steps are multiples of this."""
CASTING = 4
"""One in so many rays is under way at once: most rays meet nothing, or come from no mirror."""


class Casting(eqx.Module):
    """Part of a model that casts its reflected rays."""

    cast_share: Float[Array, ""]
    """Share of what they meet that counts, in [0, 1]: it follows a schedule, no gradient goes to it."""
    samples: int = eqx.field(static=True)
    """Along each ray, at most."""

    @classmethod
    def of(cls, config: Config, sampler: Sampler) -> "Casting | None":
        """As configured; None where no rays are cast, nothing reflects, or all that there is lies before the cameras.

        Raises UsageError: the configuration shades samples, or has no occupancy grid.
        """
        if not config.light.cast or config.field.appearance != "reflection" or isinstance(sampler.space, Frustum):
            return None
        if config.field.shading != "deferred" or not isinstance(sampler, OccupiedSteps):
            raise UsageError(
                "reflected rays cannot be cast",
                where=f"light.cast={config.light.cast}",
                why=f"field.shading is {config.field.shading}, sampler.kind is {config.sampler.kind}",
                remedy="set field.shading=deferred and sampler.kind=occupancy, or light.cast=0",
            )
        return cls(jnp.ones(()), config.light.cast)

    def through(self, sampler: Sampler) -> "Caster":
        """Casts rays where this sampler knows something to be."""
        assert isinstance(sampler, OccupiedSteps)  # see `of`
        steps = max(STEP, sampler.steps // 2 // STEP * STEP)
        return Caster(replace(sampler, max_per_ray=self.samples, steps=steps, near=0.0), self.cast_share)


class Caster(eqx.Module):
    """Casts the reflected rays of one model."""

    sampler: OccupiedSteps
    share: Float[Array, ""]

    def near(
        self, field: Field, rays: Rays, material: Material, t: Float[Array, " rays"], opacity: Float[Array, " rays"]
    ) -> Near:
        """What is near the surfaces of rays that are composited.

        Args:
            material: of each ray's surface.
            t: where the surface is.
        """
        given = (field, rays, material, Near.on(rays, t), opacity)
        return self._met(*jax.lax.stop_gradient(given))

    def _met(self, field: Field, rays: Rays, material: Material, near: Near, opacity: Float[Array, " rays"]) -> Near:
        reflected, share = self._reflected(rays, material, near.places, opacity)
        found = self.sampler.look(reflected)
        samples = eqx.tree_at(lambda s: s.valid, found.samples, found.samples.valid & (share > 0)[found.samples.ray])
        found = eqx.tree_at(lambda f: (f.samples, f.footprint), found, (samples, Footprint("gaussian")))
        queue, under_way = Queue.of(samples, jnp.asarray(share.shape[0])), -(-share.shape[0] // CASTING)
        space = self.sampler.space
        sums = barrier(composited(field, reflected, found, queue, space, normals=False, under_way=under_way)).T
        mean = sums / jnp.maximum(sums[0], 1e-6)
        there = reflected.origins.T + reflected.directions.T * mean[1]
        light = Lit.at(rays, there)
        met = field.lit(Material.unstacked(mean[2:]), light)
        shading = field.shade(met, reflected.directions.T, light=light, near=Near(there))
        return Near(near.places, met.diffuse + shading.specular, share * jnp.clip(sums[0], 0, 1))

    def _reflected(
        self, rays: Rays, material: Material, places: Float[Array, "3 rays"], opacity: Float[Array, " rays"]
    ) -> tuple[Rays, Float[Array, " rays"]]:
        """The reflected rays, a little off their surfaces and as wide as the roughness's lobe, and how much each counts."""
        normals = normalise(material.normals_pred, axis=0)
        facing, directions = mirrored(rays.viewdirs.T, normals)
        height = LIFT * 2 / self.sampler.grid.grid
        origins = places + directions * (height / jnp.maximum(facing, GRAZING))
        roughness = material.roughness[0]
        mirrors: Bool[Array, " rays"] = (opacity > CONFIDENT) & (facing > 0) & (jnp.max(material.tint, 0) > FAINT)
        share = self.share * jnp.where(mirrors, jnp.clip(2 - roughness / ROUGH, 0, 1), 0.0)
        width = 2 * jnp.sqrt(jnp.minimum(roughness, 2 * ROUGH))  # a lobe's variance across is its roughness
        return Rays(origins.T, directions.T, width), share
