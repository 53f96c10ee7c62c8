"""What a trained field says of points on its surface: the material, and the light that it reflects towards cameras.

A point's material is composited along a short way through the surface, against the mesh's normal, as a picture's pixel is.
"""

from dataclasses import dataclass, fields

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from koala3d.reconstruct.field.appearance import Material
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.numerics.compiling import compiled
from koala3d.reconstruct.numerics.safe import normalise
from koala3d.reconstruct.numerics.volume import optical_depth, volume_weights
from koala3d.reconstruct.output.mesh.field_samples import by_chunks
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.scene.light import LightFrame
from koala3d.reconstruct.scene.space import Space

CHUNK = 1 << 13  # points evaluated by one program
STEPS = 16  # samples along the way through the surface
REACH = 1 / 64
"""Half the length of that way, as a share of the longest side of the object's box."""


@dataclass(frozen=True)
class MaterialSamples:
    """The field at n points of a surface."""

    diffuse: Float[np.ndarray, "n 3"]
    """Linear light that leaves the point in all directions alike."""
    tint: Float[np.ndarray, "n 3"]
    roughness: Float[np.ndarray, " n"]
    """The model's: the inverse concentration of a von Mises-Fisher lobe."""
    normals: Float[np.ndarray, "n 3"]
    """Unit, as predicted; those of the mesh where the model predicts none, or none that face outward."""
    opacity: Float[np.ndarray, " n"]
    """How much of the light the way through the surface absorbs: below 1 the model's surface is elsewhere, or thin."""
    channels: Float[np.ndarray, "n channels"]
    """The whole material, for `Shader`."""

    def rows(self, which: Int[np.ndarray, " m"]) -> "MaterialSamples":
        """Some of the points."""
        return MaterialSamples(*(getattr(self, field.name)[which] for field in fields(self)))


def sample_material(
    trained: TrainedModel, points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]
) -> MaterialSamples:
    """The material at points (world frame and unit) of a surface with these outward unit normals."""
    normalisation = trained.run.normalisation
    low, high = np.asarray(trained.scene.box) * normalisation.scale
    step = 2 * REACH * float((high - low).max()) / STEPS
    places = (points - normalisation.centre) * normalisation.scale + normals * (step * STEPS / 2)
    field, space, frame = trained.model.field, normalisation.space, trained.run.facts.light

    def evaluate(start: Array, outward: Array) -> Array:
        return _composited(field, start, outward, jnp.asarray(step, jnp.float32), space, frame)

    values = by_chunks(evaluate, places, normals, size=CHUNK)
    material = Material.unstacked(jnp.asarray(values[:, 1:].T))
    predicted = np.asarray(material.normals_pred).T
    length = np.linalg.norm(predicted, axis=-1, keepdims=True)
    unit = predicted / np.maximum(length, 1e-6)
    usable = (length[:, 0] > 1e-3) & (np.sum(unit * normals, -1) > 0.2)
    shading = np.where(usable[:, None], unit, normals)
    return MaterialSamples(values[:, 1:4], values[:, 4:7], values[:, 7], shading, values[:, 0], values[:, 1:])


class Shader:
    """The part of a field's colour that depends on the direction, at points whose material is known."""

    def __init__(self, trained: TrainedModel, samples: MaterialSamples) -> None:
        self._field, self._frame, self._samples = trained.model.field, trained.run.facts.light, samples

    def specular(self, which: Int[np.ndarray, " n"], viewdirs: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Linear light of some of the points, by their indices, towards cameras that look along unit directions."""
        chosen = self._samples
        evaluate = lambda channels, normals, along: _specular(self._field, channels, normals, along, self._frame)  # noqa: E731
        return by_chunks(evaluate, chosen.channels[which], chosen.normals[which], viewdirs, size=CHUNK)


@compiled
def _composited(
    field: Field,
    start: Float[Array, "3 n"],
    outward: Float[Array, "3 n"],
    step: Float[Array, ""],
    space: Space,
    frame: LightFrame,
) -> Float[Array, "channels n"]:
    """Opacity and the mean material along the way from `start` against `outward`."""
    offsets = (jnp.arange(STEPS) + 0.5) * step
    points = start[:, :, None] - outward[:, :, None] * offsets
    density, material = field(Cloud(points.reshape(3, -1), None, space))
    count = start.shape[1]
    density = density.reshape(count, STEPS)
    before = jnp.pad(density[:, :-1], ((0, 0), (1, 0)))
    weights = volume_weights(optical_depth(density, before, jnp.broadcast_to(step, density.shape), solid=field.solid))
    opacity = jnp.sum(weights, -1)
    stacked = material.stacked()
    mean = jnp.sum(stacked.reshape(stacked.shape[0], count, STEPS) * weights, -1) / jnp.maximum(opacity, 1e-6)
    lit = field.under_lamps(Material.unstacked(mean), Lit.towards(frame, -outward))
    return jnp.concatenate([opacity[None], lit.stacked()])


@compiled
def _specular(
    field: Field,
    channels: Float[Array, "channels n"],
    normals: Float[Array, "3 n"],
    viewdirs: Float[Array, "3 n"],
    frame: LightFrame,
) -> Float[Array, "3 n"]:
    return field.shade(Material.unstacked(channels), viewdirs, normalise(normals, axis=0), Lit.towards(frame, viewdirs)).specular
