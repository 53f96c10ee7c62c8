"""Meshes and points by trimesh: PLY, OBJ, GLB and STL as another program writes them."""

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from trimesh.visual import TextureVisuals

from tests.foreign import photographs


def write_points(path: Path, points: NDArray[np.float64], colours: NDArray[np.uint8] | None, *, text: bool = False) -> None:
    """A PLY file of (n, 3) points as floats, with (n, 3) sRGB and an alpha."""
    trimesh.PointCloud(points, colours).export(path, encoding="ascii" if text else "binary")


def parts() -> trimesh.Scene:
    """A box with a texture, and a ball that is placed beside it, turned and enlarged."""
    box = trimesh.creation.box((0.1, 0.2, 0.06))
    uv = box.vertices[:, :2] / box.extents[:2] + 0.5
    box.visual = TextureVisuals(uv, image=Image.fromarray(photographs.corners()))
    scene = trimesh.Scene(box)
    placed = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3], point=[0.3, 0, 0]) @ np.diag([2.0, 2, 2, 1])
    scene.add_geometry(trimesh.creation.icosphere(subdivisions=1, radius=0.05), transform=placed)
    return scene


def write(path: Path, scene: trimesh.Scene) -> None:
    """The scene, in parts if the format of the suffix has parts, else as one mesh."""
    (scene if path.suffix in (".glb", ".obj") else scene.to_geometry()).export(path)
