"""The radiance field: features of a position to density and appearance.

    spatial network:  features -> raw density, what the appearance wants to know (`appearance`), bottleneck

Points, directions and channels come first: (3, n), (channels, n).
"""

import equinox as eqx
import jax
from jaxtyping import Array, Float, PRNGKeyArray

from koala3d.reconstruct.config import EncodingConfig, FieldConfig
from koala3d.reconstruct.field.appearance import Appearance, Material, Shading, Start, create_appearance
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.encodings.create import create_encoding
from koala3d.reconstruct.field.encodings.encoding import Encoding
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.field.mlp import Mlp
from koala3d.reconstruct.field.outline import Outline
from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.numerics.safe import normalise, safe_exp


class Field(eqx.Module):
    """Density and appearance over the normalised scene."""

    encoding: Encoding
    spatial: Mlp
    appearance: Appearance
    outline: Outline | None
    """What the density of a solid begins with; None: a fog."""
    density_bias: float = eqx.field(static=True)
    deferred: bool = eqx.field(static=True)
    """Whether a ray is shaded once, on its composited material, or at each of its samples."""

    @classmethod
    def create(
        cls,
        key: PRNGKeyArray,
        encoding: EncodingConfig,
        field: FieldConfig,
        *,
        start: Start | None = None,
        outline: Outline | None = None,
    ) -> "Field":
        """Fresh weights for the given sizes.

        Args:
            start: where the object is, for appearances that begin differently around it.
            outline: what the density begins with; None: thin fog.
        """
        encoding_key, spatial_key, view_key = jax.random.split(key, 3)
        encoded = create_encoding(encoding_key, encoding)
        appearance = create_appearance(view_key, field, start)
        spatial = Mlp.create(
            spatial_key,
            channels=encoded.num_channels,
            width=field.spatial_width,
            depth=field.spatial_depth,
            outputs=1 + appearance.heads + field.bottleneck,
            skip=field.spatial_skip,
        )
        return cls(encoded, spatial, appearance, outline, field.density_bias, field.shading == "deferred")

    @property
    def solid(self) -> bool:
        """Whether light is lost where the density rises, and not along the way; see `volume.optical_depth`."""
        return self.outline is not None

    def density(self, cloud: Cloud) -> Float[Array, " n"]:
        """Density alone [1 / scene unit]."""
        return self._activated(self.spatial.only(1)(cloud.encoded(self.encoding))[0], cloud)

    def __call__(self, cloud: Cloud) -> tuple[Float[Array, " n"], Material]:
        """Density [1 / scene unit] and material."""
        return self._heads(self.spatial(cloud.encoded(self.encoding)), cloud)

    def with_normals(self, cloud: Cloud, shown: int | None = None) -> tuple[Float[Array, " n"], Material, Float[Array, "3 n"]]:
        """Density, material and unit normals: minus the direction of the density's gradient, analytically.

        exp is monotonic, so the gradient of the density's logarithm has the same direction and never overflows.

        Args:
            shown: number of places, the first ones, whose material is wanted; None: all.
        """
        features, jacobian = cloud.encoded_with_jacobian(self.encoding)
        raw, sensitivity = self.spatial.with_sensitivity(features)
        slope = cloud.gradient(sensitivity, jacobian)
        if self.outline is not None:
            slope = self.outline.slope(slope, cloud.centres())
        return *self._heads(raw, cloud, shown), -normalise(barrier(slope), axis=0)

    def held_but_for_heads(self) -> "Field":
        """The same, of which only the last layer of the spatial network is learned: a loss of materials then moves no density."""
        held: Field = jax.lax.stop_gradient(self)
        last = lambda field: (field.spatial.weights[-1], field.spatial.biases[-1])  # noqa: E731
        return eqx.tree_at(last, held, last(self))

    def under_lamps(self, material: Material, light: Lit | None) -> Material:
        """The material with its diffuse colour under lamps that move about it; as it is where they stand still (None)."""
        return material if light is None else self.appearance.under_lamps(material, light)

    def shade(
        self,
        material: Material,
        viewdirs: Float[Array, "3 n"],
        normals: Float[Array, "3 n"] | None = None,
        light: Lit | None = None,
        places: Float[Array, "3 n"] | None = None,
    ) -> Shading:
        """Colour of a `lit` material towards a camera that looks along unit `viewdirs`.

        Args:
            normals: unit normals to reflect about; None takes the predicted ones.
            light: how the points are to lamps that move about them.
            places: where the points are [scene unit]; None: all that they reflect is far away.
        """
        return self.appearance.shade(material, viewdirs, normals, light, places)

    def _activated(self, raw: Float[Array, " n"], cloud: Cloud) -> Float[Array, " n"]:
        if self.outline is None:
            return safe_exp(raw + self.density_bias)
        return safe_exp(self.outline.log_density(raw, cloud.centres()))

    def _heads(
        self, raw: Float[Array, "channels n"], cloud: Cloud, shown: int | None = None
    ) -> tuple[Float[Array, " n"], Material]:
        return self._activated(raw[0], cloud), self.appearance.material(raw[1:, :shown], cloud.centres()[:, :shown])
