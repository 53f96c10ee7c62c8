"""What is known of each vertex of a mesh that was extracted from a trained model: what views see, and what the model says."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from koala3d.datasets.core.console import progress
from koala3d.datasets.scene import View
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.numerics.compiling import compiled
from koala3d.reconstruct.output.mesh.field_samples import by_chunks
from koala3d.reconstruct.output.mesh.visibility import seen_from
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.scene.light import LightFrame
from koala3d.reconstruct.scene.rays import scaled_camera
from koala3d.reconstruct.scene.space import Space

if TYPE_CHECKING:
    import trimesh

ROUGH = 0.1
"""The model's roughness (inverse concentration of a lobe) at which a reflection is half as sharp as a mirror's."""
CHUNK = 1 << 11
"""Vertices evaluated by one program."""


@dataclass(frozen=True)
class Evidence:
    """Of v vertices; lengths in the scene's world unit."""

    views: Int[np.ndarray, " v"]
    """Training views that see the vertex, not at a grazing angle."""
    spread: Float[np.ndarray, " v"]
    """Root mean square angle of their directions from the mean direction [rad]."""
    pixel: Float[np.ndarray, " v"]
    """Width of a pixel there, at the scale of the training: the median view's."""
    depth: Float[np.ndarray, " v"]
    """How deep the vertex lies in the visual hull: what outlines leave open. Outside it, 0; infinite where there are no masks."""
    mirror: Float[np.ndarray, " v"]
    """Share of its light that depends on the direction, times how sharp the reflection is, in 0..1."""
    slope: Float[np.ndarray, " v"]
    """Tangent of the angle between the mesh's normal and the predicted one; 0 where none is predicted."""


def of(trained: TrainedModel, mesh: "trimesh.Trimesh") -> Evidence:
    """The evidence for the vertices of a mesh in the world frame, with outward normals."""
    points, normals = (np.asarray(one, np.float64) for one in (mesh.vertices, mesh.vertex_normals))
    views, spread, pixel, depth = _seen(trained, points, normals)
    field, facts = trained.model.field, trained.run.facts
    local = (points - facts.normalisation.centre) * facts.normalisation.scale
    at = lambda p, n: _at(field, p, n, facts.normalisation.space, facts.light)  # noqa: E731
    values = by_chunks(at, local, normals, size=CHUNK)
    mirror, predicted = values[:, 0], values[:, 1:]
    cosine = np.clip(np.abs(np.sum(predicted * normals, -1)), 0.1, 1)
    is_predicted = np.linalg.norm(predicted, axis=-1) > 0.5
    slope = np.where(is_predicted, np.sqrt(1 - cosine**2) / cosine, 0.0)
    return Evidence(views, spread, pixel, depth, mirror.astype(np.float64), slope)


def _seen(
    trained: TrainedModel, points: Float[np.ndarray, "v 3"], normals: Float[np.ndarray, "v 3"]
) -> tuple[Int[np.ndarray, " v"], Float[np.ndarray, " v"], Float[np.ndarray, " v"], Float[np.ndarray, " v"]]:
    """Number of views, spread of directions, width of a pixel, depth in the hull."""
    views = trained.scene.split("train")
    count, total, depth = np.zeros(len(points), np.int64), np.zeros((len(points), 3)), np.full(len(points), np.inf)
    widths = []
    with progress("looking at the surface from the cameras", len(views), "views") as shown:
        for view, (seen, rays) in zip(views, seen_from(points, normals, views), strict=True):
            away = np.linalg.norm(points - view.world_from_camera[:3, 3], axis=-1)
            count += seen
            total[seen] += rays[seen]
            widths.append(away / scaled_camera(view, trained.run.config.scale).fx)
            depth = np.minimum(depth, _inside(view, points, trained.run.config.scale))
            shown.advance()
    length = np.linalg.norm(total, axis=-1) / np.maximum(count, 1)
    return count, np.sqrt(np.maximum(2 * (1 - length), 0)), np.median(np.stack(widths), axis=0), np.maximum(depth, 0)


def _inside(view: View, points: Float[np.ndarray, "v 3"], scale: float) -> Float[np.ndarray, " v"]:
    """How far points are inside the outline that a view has of the object, across the line of sight; infinite without one."""
    from scipy.ndimage import distance_transform_edt

    camera, far = scaled_camera(view, scale), np.full(len(points), np.inf)
    if view.counted(camera) is not None:
        return far  # an edge of what is left out is no outline
    cover = view.read_cover(camera.width, camera.height) > 0.5
    if cover.all():
        return far
    inside = distance_transform_edt(np.pad(cover, 1, mode="edge"))[1:-1, 1:-1] - 0.5
    local = (points - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
    front = local[:, 2] > 1e-6
    at = camera.project(np.where(front[:, None], local, [0.0, 0.0, 1.0]))
    column, row = np.floor(np.clip(at, -1, 1e6)).astype(np.int64).T
    front &= (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
    far[front] = inside[row[front], column[front]] * local[front, 2] / camera.fx
    return far


@compiled
def _at(
    field: Field, points: Float[Array, "3 n"], normals: Float[Array, "3 n"], space: Space, frame: LightFrame
) -> Float[Array, "4 n"]:
    """Mirror, predicted normal."""
    _, material = field(Cloud(points, None, space))
    light = Lit.towards(frame, -normals)
    lit = field.under_lamps(material, light)
    shiny = jnp.sum(jnp.abs(field.shade(lit, -normals, light=light, places=points).specular), 0)
    share = shiny / jnp.maximum(shiny + jnp.sum(lit.diffuse, 0), 1e-6)
    sharp = 1 / (1 + jnp.maximum(material.roughness[0], 0.0) / ROUGH)
    return jnp.concatenate([(share * sharp)[None], material.normals_pred])
