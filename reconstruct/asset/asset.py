"""An asset: a textured mesh in a frame of its own, metres and y up as glTF wants them."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from koala3d.datasets import pose
from koala3d.reconstruct.asset.bake import Surface
from koala3d.reconstruct.asset.light import Light
from koala3d.reconstruct.asset.materials import Textures, textures
from koala3d.reconstruct.asset.texels import texels_of
from koala3d.reconstruct.asset.unwrap import Unwrapped, unwrap
from koala3d.reconstruct.output.mesh import extraction
from koala3d.reconstruct.output.mesh.files import points_on
from koala3d.reconstruct.output.shape import uncertainty
from koala3d.reconstruct.output.trained_model import TrainedModel

if TYPE_CHECKING:
    import trimesh

FACES, SIZE = 20_000, 1024
"""Default target number of triangles, and texels along a side of the textures."""
LIT_POINTS = 60_000  # of the surface, for what is in whose light


@dataclass(frozen=True)
class Asset:
    """Everything that files of an asset are written from."""

    name: str
    mesh: Unwrapped
    """In the asset's frame: y up, the origin below the middle of the object, where it stands."""
    textures: Textures
    base_from_asset: Float[np.ndarray, "4 4"]
    """To the world frame of the scene, which is the robot's base for a capture."""
    metric: bool
    """Whether lengths are metres; else they are the scene's units."""
    about: dict[str, Any]
    """What files keep of its origin: run, scene, certainty."""


def make(
    trained: TrainedModel,
    *,
    faces: int = FACES,
    size: int = SIZE,
    resolution: int = extraction.RESOLUTION,
    stands_on: str | None = None,
    closed: bool = True,
) -> tuple[Asset, Light]:
    """Extract, unwrap and bake a trained model.

    Args:
        faces: target number of triangles.
        size: texels along a side of the textures.
        resolution: see `extraction.extract`, as `stands_on`; `closed` is its `watertight`.
    """
    options = {"resolution": resolution, "watertight": closed, "stands_on": stands_on}
    return bake(trained, extraction.extract(trained, faces=faces, **options), size=size, stands_on=stands_on)


def bake(
    trained: TrainedModel, surface: "trimesh.Trimesh", *, size: int = SIZE, stands_on: str | None = None
) -> tuple[Asset, Light]:
    """The asset of a trained model with a surface that is there already (world frame)."""
    mesh = unwrap(surface, size)
    texels = texels_of(mesh, size)
    light = light_around(trained, surface)
    baked = Surface(trained, texels.points, texels.normals).baked(light)
    frame = base_from_asset(surface.vertices, stands_on)
    about = {
        "run": str(trained.run.path),
        "scene": trained.scene.name,
        "steps": trained.step,
        "certainty": baked.certainty.summary(),
        "shape": uncertainty.of(trained, surface).summary(),
        "specular_unexplained": baked.unexplained,
        "texels": len(texels.points),
    }
    moved = mesh.moved(np.linalg.inv(frame))
    return Asset(trained.scene.name, moved, textures(texels, baked), frame, trained.scene.metric, about), light


def light_around(trained: TrainedModel, surface: "trimesh.Trimesh") -> Light:
    """The light around a trained model with this surface (world frame); the same for the same surface, whatever the textures."""
    points = points_on(surface, LIT_POINTS)
    return Surface(trained, np.asarray(points.vertices), np.asarray(points.vertex_normals)).light()


def base_from_asset(vertices: Float[np.ndarray, "v 3"], stands_on: str | None = None) -> Float[np.ndarray, "4 4"]:
    """The pose of the asset's frame: its y axis points away from the side that the object stands on (from -z without one)."""
    side = stands_on or "-z"
    axis = "xyz".index(side[1])
    up = np.zeros(3)
    up[axis] = 1.0 if side[0] == "-" else -1.0
    right = np.eye(3)[(axis + 1) % 3]  # x for z up
    low, high = vertices.min(0), vertices.max(0)
    origin = (low + high) / 2
    origin[axis] = low[axis] if side[0] == "-" else high[axis]
    return pose.rigid(np.stack([right, up, np.cross(right, up)], -1), origin)
