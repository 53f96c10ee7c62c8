"""From what the spatial network knows of a point to its colour: one class per way to look at light.

    Reflection    Ref-NeRF (Verbin et al. 2022, section 3): srgb(diffuse + tint * specular(reflected direction, roughness, n . v))
    Matte         srgb(diffuse), from all sides
    ViewColour    NeRF, Mip-NeRF, Zip-NeRF: colour(view direction); with a diffuse colour srgb(diffuse + specular(direction))

Points, directions and channels come first: (3, n), (channels, n).
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from koala3d.reconstruct.config import FieldConfig
from koala3d.reconstruct.field.encodings.directional import (
    ide_channels,
    integrated_directional_encoding,
    view_channels,
    view_encoding,
)
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.field.mlp import Mlp
from koala3d.reconstruct.field.moving_lamps import MovingLamps
from koala3d.reconstruct.field.parallax import Parallax
from koala3d.reconstruct.numerics.safe import linear_from_srgb, normalise, srgb_from_linear
from koala3d.reconstruct.scene.light import STILL, LightFrame

VIEW_DEGREE = 4
"""Octaves of sines that encode a view direction that is not reflected."""


class Material(eqx.Module):
    """Appearance of points before the view direction is known. Linear colour."""

    diffuse: Float[Array, "3 n"]
    tint: Float[Array, "3 n"]
    roughness: Float[Array, "1 n"]
    normals_pred: Float[Array, "3 n"]
    """Unit; zero where the model predicts none."""
    bottleneck: Float[Array, "channels n"]

    @property
    def parts(self) -> tuple[Float[Array, "_ n"], ...]:
        """All of it, to be composited."""
        return self.diffuse, self.tint, self.roughness, self.normals_pred, self.bottleneck

    def stacked(self) -> Float[Array, "channels n"]:
        """`parts` as one array."""
        return jnp.concatenate(self.parts)

    @classmethod
    def unstacked(cls, channels: Float[Array, "channels n"]) -> "Material":
        """Inverse of `stacked`."""
        return cls(channels[0:3], channels[3:6], channels[6:7], channels[7:10], channels[10:])


class Shading(eqx.Module):
    """Colour of points seen from given directions."""

    rgb: Float[Array, "3 n"]
    """sRGB in [0, 1], padded by 0.001 as Ref-NeRF has it."""
    specular: Float[Array, "3 n"]
    """The part that depends on the direction, tint included, linear; all of the colour where nothing is diffuse."""


@dataclass(frozen=True)
class Start:
    """Where the object, the cameras and the lamps are; None where that is not known."""

    towards: tuple[float, float, float] | None = None
    """Mean direction from the object to the cameras."""
    light: LightFrame = STILL
    """Where the lamps stand still."""
    parallax: Parallax | None = None
    """How far away the lamps are; None: infinitely."""


class StartNormals(eqx.Module):
    """Normals before anything is learned: those of a ball about the object, turned towards where the cameras are.

    A camera that looks down on a table must not begin with a table that faces away from it: what reflects no light towards
    the camera is left out of the picture, and fog before it takes its place.
    """

    outward: float = eqx.field(static=True)
    towards: Float[Array, " 3"]
    """Mean direction from the object to the cameras: data, so that what was compiled for one scene serves the next."""

    @classmethod
    def of(cls, field: FieldConfig, start: Start) -> "StartNormals":
        """Not turned where the cameras' direction is not known."""
        return cls(field.outward, jnp.asarray(start.towards or (0.0, 0.0, 0.0), jnp.float32))

    def at(self, points: Float[Array, "3 n"]) -> Float[Array, "3 n"]:
        """Not unit: its length says how much the network must say to turn it."""
        return self.outward * (points + self.towards[:, None])


class Reflection(eqx.Module):
    """Diffuse colour, tint, roughness and a predicted normal, about which the view direction is reflected.

    What an untrained network shows decides what the training finds. With Ref-NeRF's biases half the colour is diffuse, and
    the reflection, a product of two factors that both have to fall, dies before there is a shape to reflect it. With a
    dark diffuse part and normals that begin as a ball's, the reflection carries the colour from the first step.
    """

    view: Mlp
    ide_degree: int = eqx.field(static=True)
    diffuse_bias: float = eqx.field(static=True)
    specular_bias: float = eqx.field(static=True)
    roughness_bias: float = eqx.field(static=True)
    start: StartNormals
    moving: MovingLamps | None = None
    """None where lamps stand still about the object."""
    parallax: Parallax | None = None
    """None where lamps are infinitely far, or near and on the camera: their light depends on the place already."""

    heads: ClassVar[int] = 10
    """Diffuse (3), tint (3), roughness, normal (3); the bottleneck follows."""
    has_diffuse: ClassVar[bool] = True
    predicts_normals: ClassVar[bool] = True

    @classmethod
    def create(cls, key: PRNGKeyArray, field: FieldConfig, start: Start) -> "Reflection":
        """Fresh weights for the given sizes."""
        moving = MovingLamps.create(jax.random.fold_in(key, 1), start.light) if start.light.moves else None
        channels = field.bottleneck + ide_channels(field.ide_degree) + 1 + (moving.channels if moving else 0)
        network = _view_network(key, channels, field)
        biases = (field.diffuse_bias, field.specular_bias, field.roughness_bias)
        parallax = None if start.light.near else start.parallax
        return cls(network, field.ide_degree, *biases, StartNormals.of(field, start), moving, parallax)

    def material(self, raw: Float[Array, "channels n"], points: Float[Array, "3 n"]) -> Material:
        """Heads of the spatial network's outputs at the given places of the contracted scene."""
        return Material(
            diffuse=jax.nn.sigmoid(raw[0:3] + self.diffuse_bias),
            tint=jax.nn.sigmoid(raw[3:6]),
            roughness=jax.nn.softplus(raw[6:7] + self.roughness_bias),
            normals_pred=normalise(self.start.at(points) - raw[7:10], axis=0),
            bottleneck=raw[10:],
        )

    def shade(
        self,
        material: Material,
        viewdirs: Float[Array, "3 n"],
        normals: Float[Array, "3 n"] | None = None,
        light: Lit | None = None,
        places: Float[Array, "3 n"] | None = None,
    ) -> Shading:
        """Colour towards a camera that looks along unit `viewdirs`.

        Args:
            normals: in place of the predicted ones.
            places: where the points are [scene unit]; None: as if light came from afar.
        """
        normals = normalise(material.normals_pred, axis=0) if normals is None else normals
        facing, reflected = mirrored(viewdirs, normals)
        if self.parallax is not None and places is not None:
            reflected = self.parallax.towards(reflected, places)
        from_lens = []
        if self.moving is not None and light is not None:
            reflected, from_lens = self.moving.seen_by(light, reflected)
        encoded = integrated_directional_encoding(reflected, material.roughness[0], self.ide_degree)
        raw = self.view(jnp.concatenate([material.bottleneck, encoded, facing[None], *from_lens]))
        return _sum_of_parts(material.diffuse, material.tint * jax.nn.sigmoid(raw + self.specular_bias))

    def under_lamps(self, material: Material, light: Lit) -> Material:
        """The material with its diffuse colour under lamps that move about it."""
        if self.moving is None:
            return material
        irradiance = self.moving.irradiance(light, normalise(material.normals_pred, axis=0))
        return replace(material, diffuse=material.diffuse * irradiance)


class ViewColour(eqx.Module):
    """Colour by the direction of the view, all of it or what is added to a diffuse colour, wherever lamps stand."""

    view: Mlp
    has_diffuse: bool = eqx.field(static=True)
    diffuse_bias: float = eqx.field(static=True)

    predicts_normals: ClassVar[bool] = False
    parallax: ClassVar[None] = None

    @classmethod
    def create(cls, key: PRNGKeyArray, field: FieldConfig) -> "ViewColour":
        """Fresh weights for the given sizes."""
        network = _view_network(key, field.bottleneck + view_channels(VIEW_DEGREE), field)
        return cls(network, field.appearance == "view_diffuse", field.diffuse_bias)

    @property
    def heads(self) -> int:
        """Diffuse (3), where there is one; the bottleneck follows."""
        return 3 if self.has_diffuse else 0

    def material(self, raw: Float[Array, "channels n"], points: Float[Array, "3 n"]) -> Material:
        """Heads of the spatial network's outputs, wherever the points are."""
        count = raw.shape[1]
        diffuse = jax.nn.sigmoid(raw[0:3] + self.diffuse_bias) if self.has_diffuse else jnp.zeros((3, count))
        return Material(diffuse, jnp.ones((3, count)), jnp.zeros((1, count)), jnp.zeros((3, count)), raw[self.heads :])

    def shade(
        self,
        material: Material,
        viewdirs: Float[Array, "3 n"],
        normals: Float[Array, "3 n"] | None = None,
        light: Lit | None = None,
        places: Float[Array, "3 n"] | None = None,
    ) -> Shading:
        """Colour towards a camera that looks along unit `viewdirs`, whatever the normals."""
        raw = self.view(jnp.concatenate([material.bottleneck, view_encoding(viewdirs, VIEW_DEGREE)]))
        colour = jax.nn.sigmoid(raw)
        if self.has_diffuse:
            return _sum_of_parts(material.diffuse, colour)
        return Shading(colour * 1.002 - 0.001, linear_from_srgb(colour))

    def under_lamps(self, material: Material, light: Lit) -> Material:
        """The same material."""
        return material


class Matte(eqx.Module):
    """What is left of `Reflection` where nothing is reflected: the diffuse colour, and normals that the density's follow."""

    diffuse_bias: float = eqx.field(static=True)
    start: StartNormals

    heads: ClassVar[int] = 6
    """Diffuse (3), normal (3); the bottleneck follows."""
    has_diffuse: ClassVar[bool] = True
    predicts_normals: ClassVar[bool] = True
    parallax: ClassVar[None] = None

    def material(self, raw: Float[Array, "channels n"], points: Float[Array, "3 n"]) -> Material:
        """Heads of the spatial network's outputs at the given places of the contracted scene."""
        dark = jnp.zeros((3, raw.shape[1]))
        normals = normalise(self.start.at(points) - raw[3:6], axis=0)
        return Material(jax.nn.sigmoid(raw[0:3] + self.diffuse_bias), dark, dark[:1], normals, raw[self.heads :])

    def shade(
        self,
        material: Material,
        viewdirs: Float[Array, "3 n"],
        normals: Float[Array, "3 n"] | None = None,
        light: Lit | None = None,
        places: Float[Array, "3 n"] | None = None,
    ) -> Shading:
        """The same colour from all sides."""
        return _sum_of_parts(material.diffuse, jnp.zeros_like(material.diffuse))

    def under_lamps(self, material: Material, light: Lit) -> Material:
        """The same material."""
        return material


Appearance = Reflection | Matte | ViewColour


def mirrored(viewdirs: Float[Array, "3 n"], normals: Float[Array, "3 n"]) -> tuple[Float[Array, " n"], Float[Array, "3 n"]]:
    """Cosine between unit normals and the way to the camera, and the unit reflected directions (Ref-NeRF, equation 4)."""
    facing = -jnp.sum(normals * viewdirs, axis=0)
    return facing, 2 * facing * normals + viewdirs


def create_appearance(key: PRNGKeyArray, field: FieldConfig, start: Start | None = None) -> Appearance:
    """The appearance that a configuration names. `start`: where the object is; None: not known."""
    start = start or Start()
    if field.appearance == "diffuse":
        return Matte(field.diffuse_bias, StartNormals.of(field, start))
    return Reflection.create(key, field, start) if field.appearance == "reflection" else ViewColour.create(key, field)


def _view_network(key: PRNGKeyArray, channels: int, field: FieldConfig) -> Mlp:
    return Mlp.create(key, channels=channels, width=field.view_width, depth=field.view_depth, outputs=3, skip=field.view_skip)


def _sum_of_parts(diffuse: Float[Array, "3 n"], specular: Float[Array, "3 n"]) -> Shading:
    rgb = jnp.clip(srgb_from_linear(diffuse + specular), 0.0, 1.0)
    return Shading(rgb * 1.002 - 0.001, specular)
