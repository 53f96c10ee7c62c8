"""Renders a small picture of a ball in even light, then exits with 0. Run in a child, which may crash.

python -m koala3d.reconstruct.path_tracing.trial llvm_ad_rgb
"""

import sys

import numpy as np

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.reconstruct.path_tracing.reading import StoredAsset


def ball() -> StoredAsset:
    """A grey metal ball of radius 1."""
    from trimesh.creation import icosphere

    mesh = icosphere(subdivisions=2)
    points, even = np.asarray(mesh.vertices), np.ones((4, 4, 1), np.float32)
    flat = np.array([0.5, 0.5, 1.0], np.float32) * even
    return StoredAsset(
        points, points, points[:, :2] / 2 + 0.5, np.asarray(mesh.faces), 0.5 * flat**0, even, 0.3 * even, flat, None, np.eye(4)
    )


def main(using: str) -> int:
    """Return 0 if the variant `using` shows a ball with finite values."""
    from koala3d.reconstruct.path_tracing.renderer import Renderer

    camera = Camera(16, 16, 24.0, 24.0, 8.0, 8.0)
    place = pose.look_at(np.array([0.0, 0.0, 4.0]), np.zeros(3), up=np.array([0.0, 1.0, 0.0]))
    found = Renderer(ball(), np.ones((8, 16, 3)), using=using).picture(camera, place, paths=4, seed=0)
    return 0 if np.isfinite(found).all() and found[8, 8, :3].min() > 0 else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
