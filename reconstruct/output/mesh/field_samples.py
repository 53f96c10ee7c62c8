"""Samples of a trained field for its mesh: density on a regular grid, colours and predicted normals at vertices."""

from collections.abc import Callable, Iterator

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from koala3d.datasets.core.console import progress
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.numerics.compiling import compiled
from koala3d.reconstruct.numerics.safe import normalise
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.rendering.pictures import ahead
from koala3d.reconstruct.scene.light import LightFrame
from koala3d.reconstruct.scene.space import Space

CHUNK = 1 << 15  # points evaluated by one program
Axes = tuple[NDArray[np.float64], ...]  # coordinates of the grid points along x, y and z [scene unit]


def grid_axes(trained: TrainedModel, resolution: int) -> Axes:
    """A grid of equal spacing that covers the object's box, with `resolution` points along its longest side."""
    normalisation = trained.run.normalisation
    low, high = (np.asarray(trained.scene.box) - normalisation.centre) * normalisation.scale
    spacing = (high - low).max() / (resolution - 1)
    return tuple(a + spacing * np.arange(int(np.ceil((b - a) / spacing - 1e-6)) + 1) for a, b in zip(low, high, strict=True))


def sample_density(trained: TrainedModel, axes: Axes) -> Float[np.ndarray, "x y z"]:
    """Density [1 / scene unit] at the grid points; zero where the occupancy grid is empty around."""
    wanted = trained.model.sampler.near_occupied(axes)
    if wanted is None:
        wanted = np.ones(tuple(len(axis) for axis in axes), bool)
    density = np.zeros(wanted.shape, np.float32)
    index = np.flatnonzero(wanted)
    field, space = trained.model.field, trained.run.normalisation.space
    with progress("sampling density", len(index) / 1e6, "million points") as bar:

        def chunks() -> Iterator[tuple[NDArray, Float[Array, " n"]]]:
            for start in range(0, len(index), CHUNK):
                part = index[start : start + CHUNK]
                places = np.unravel_index(part, wanted.shape)
                points = _padded(np.stack([axis[place] for axis, place in zip(axes, places, strict=True)], -1))
                yield part, _density(field, points, space)

        for part, values in ahead(chunks()):
            density.reshape(-1)[part] = np.asarray(values)[: len(part)]
            bar.advance(len(part) / 1e6)
    return density


def frontal_colours(trained: TrainedModel, points: NDArray, normals: NDArray) -> NDArray[np.uint8]:
    """(n, 3) sRGB of points [scene unit] viewed along their normals: diffuse and specular, as metals have no diffuse part."""
    field, facts = trained.model.field, trained.run.facts
    space, frame = facts.normalisation.space, facts.light
    values = by_chunks(lambda part, facing: _colour(field, part, facing, space, frame), points, normals)
    return np.round(255 * np.clip(values, 0, 1)).astype(np.uint8)


def predicted_normals(trained: TrainedModel, points: NDArray) -> NDArray[np.float32]:
    """(n, 3) unit normals that the model predicts at points [scene unit]."""
    field, space = trained.model.field, trained.run.normalisation.space
    return by_chunks(lambda part: _normals(field, part, space), points)


def by_chunks(function: Callable[..., Float[Array, "channels n"]], *arrays: NDArray, size: int = CHUNK) -> NDArray[np.float32]:
    """(n, channels) values of a function of (k, size) arrays at the rows of (n, k) arrays."""
    count = len(arrays[0])
    starts = range(0, max(count, 1), size)  # of no rows, too, there are channels
    begun = (function(*(_padded(array[start : start + size], size) for array in arrays)) for start in starts)
    return np.concatenate([np.asarray(found).T for found in ahead(begun)])[:count]


def _padded(rows: NDArray, size: int = CHUNK) -> Float[Array, "k n"]:
    """(k, size): one compiled program serves all chunks."""
    padded = np.zeros((rows.shape[1], size), np.float32)
    padded[:, : len(rows)] = rows.T
    return jnp.asarray(padded)


@compiled
def _density(field: Field, points: Float[Array, "3 n"], space: Space) -> Float[Array, " n"]:
    return field.density(Cloud(points, None, space))


@compiled
def _colour(
    field: Field, points: Float[Array, "3 n"], normals: Float[Array, "3 n"], space: Space, frame: LightFrame
) -> Float[Array, "3 n"]:
    _, material = field(Cloud(points, None, space))
    light = Lit.towards(frame, -normals)
    return field.shade(field.under_lamps(material, light), -normals, light=light, places=points).rgb


@compiled
def _normals(field: Field, points: Float[Array, "3 n"], space: Space) -> Float[Array, "3 n"]:
    _, material = field(Cloud(points, None, space))
    return normalise(material.normals_pred, axis=0)
