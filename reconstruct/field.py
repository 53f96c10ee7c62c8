"""The radiance field: lattice features to density and appearance (Ref-NeRF heads, Verbin et al. 2022, section 3).

    spatial network:  features -> raw density, diffuse colour, tint, roughness, normal, bottleneck
    view network:     bottleneck, IDE(reflected view direction, roughness), n . v -> specular colour
    colour = srgb(diffuse + tint * specular)

Points, directions and channels come first: (3, n), (channels, n).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from reconstruct.cloud import Cloud
from reconstruct.config import EncodingConfig, FieldConfig
from reconstruct.encodings.directional import ide_channels, integrated_directional_encoding
from reconstruct.encodings.lattice import PermutohedralLattice
from reconstruct.mlp import Mlp
from reconstruct.safe import normalise, safe_exp, srgb_from_linear

HEADS = 11
"""Raw density, diffuse (3), tint (3), roughness, normal (3); the bottleneck follows."""


class Material(eqx.Module):
    """Appearance of points before the view direction is known. Linear colour."""

    diffuse: Float[Array, "3 n"]
    tint: Float[Array, "3 n"]
    roughness: Float[Array, "1 n"]
    normals_pred: Float[Array, "3 n"]
    bottleneck: Float[Array, "channels n"]

    def stacked(self) -> Float[Array, "channels n"]:
        """All of it as one array, to be composited."""
        return jnp.concatenate([self.diffuse, self.tint, self.roughness, self.normals_pred, self.bottleneck])

    @classmethod
    def unstacked(cls, channels: Float[Array, "channels n"]) -> "Material":
        """Inverse of `stacked`."""
        return cls(channels[0:3], channels[3:6], channels[6:7], channels[7:10], channels[10:])


class Shading(eqx.Module):
    """Colour of points seen from given directions."""

    rgb: Float[Array, "3 n"]
    """sRGB in [0, 1], padded by 0.001 as Ref-NeRF has it."""
    specular: Float[Array, "3 n"]
    """tint times specular colour, linear."""


class Field(eqx.Module):
    """Density and appearance over the normalised scene."""

    encoding: PermutohedralLattice
    spatial: Mlp
    view: Mlp
    ide_degree: int = eqx.field(static=True)
    density_bias: float = eqx.field(static=True)

    @classmethod
    def create(cls, key: PRNGKeyArray, encoding: EncodingConfig, field: FieldConfig) -> "Field":
        """Fresh weights for the given sizes."""
        lattice_key, spatial_key, view_key = jax.random.split(key, 3)
        lattice = PermutohedralLattice.create(lattice_key, **encoding.model_dump())
        spatial = Mlp.create(spatial_key, channels=lattice.num_channels, width=field.spatial_width,
                             depth=field.spatial_depth, outputs=HEADS + field.bottleneck)  # fmt: skip
        view = Mlp.create(view_key, channels=field.bottleneck + ide_channels(field.ide_degree) + 1, width=field.view_width,
                          depth=field.view_depth, outputs=3, skip=field.view_skip)  # fmt: skip
        return cls(lattice, spatial, view, field.ide_degree, field.density_bias)

    def density(self, cloud: Cloud) -> Float[Array, " n"]:
        """Density alone [1 / scene unit]."""
        return self._activated(self.spatial(cloud.encoded(self.encoding))[0])

    def __call__(self, cloud: Cloud) -> tuple[Float[Array, " n"], Material]:
        """Density [1 / scene unit] and material."""
        return self._heads(self.spatial(cloud.encoded(self.encoding)))

    def with_normals(self, cloud: Cloud) -> tuple[Float[Array, " n"], Material, Float[Array, "3 n"]]:
        """Density, material and unit normals: minus the direction of the density's gradient, analytically.

        exp is monotonic, so the raw density's gradient has the same direction and never overflows.
        """
        features, jacobian = cloud.encoded_with_jacobian(self.encoding)
        raw, pull = jax.vjp(self.spatial, features)
        (sensitivity,) = pull(jnp.zeros_like(raw).at[0].set(1.0))
        gradient = jnp.einsum("cn,cxn->xn", sensitivity, jacobian)
        return *self._heads(raw), -normalise(gradient, axis=0)

    def shade(self, material: Material, viewdirs: Float[Array, "3 n"], normals: Float[Array, "3 n"] | None = None) -> Shading:
        """Colour towards a camera that looks along unit `viewdirs`.

        Args:
            normals: unit normals to reflect about; None takes the predicted ones.
        """
        normals = normalise(material.normals_pred, axis=0) if normals is None else normals
        facing = -jnp.sum(normals * viewdirs, axis=0)
        reflected = 2 * facing * normals + viewdirs  # Ref-NeRF equation 4, with the direction towards the camera -viewdirs
        encoded = integrated_directional_encoding(reflected, material.roughness[0], self.ide_degree)
        raw = self.view(jnp.concatenate([material.bottleneck, encoded, facing[None]]))
        specular = material.tint * jax.nn.sigmoid(raw)
        rgb = jnp.clip(srgb_from_linear(material.diffuse + specular), 0.0, 1.0)
        return Shading(rgb * 1.002 - 0.001, specular)

    def _activated(self, raw: Float[Array, " n"]) -> Float[Array, " n"]:
        return safe_exp(raw + self.density_bias)

    def _heads(self, raw: Float[Array, "channels n"]) -> tuple[Float[Array, " n"], Material]:
        material = Material(
            diffuse=jax.nn.sigmoid(raw[1:4] - np.log(3.0)), tint=jax.nn.sigmoid(raw[4:7]),
            roughness=jax.nn.softplus(raw[7:8] - 1.0), normals_pred=-normalise(raw[8:11], axis=0), bottleneck=raw[HEADS:],
        )  # fmt: skip
        return self._activated(raw[0]), material
