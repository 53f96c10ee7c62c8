"""Similarities: rotation, translation and one factor of length, as between a model from pictures and the world."""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets import pose
from koala3d.datasets.scene import View

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Similarity:
    """Takes x to scale * rotation @ x + translation."""

    scale: float = 1.0
    rotation: Array = field(default_factory=lambda: np.eye(3))
    translation: Array = field(default_factory=lambda: np.zeros(3))

    def points(self, points: ArrayLike) -> Array:
        """(..., 3) points in the new world."""
        return self.scale * np.asarray(points, np.float64) @ self.rotation.T + self.translation

    def view(self, view: View) -> View:
        """A view in the new world; its pictures are the same."""
        matrix, placed = view.world_from_camera, view.base_from_world
        if placed is not None:
            turn = placed[:3, :3] @ self.rotation.T
            placed = pose.rigid(turn, self.scale * placed[:3, 3] - turn @ self.translation)
        moved = pose.rigid(self.rotation @ matrix[:3, :3], self.points(matrix[:3, 3]))
        return replace(view, world_from_camera=moved, base_from_world=placed)

    def after(self, first: Self) -> "Similarity":
        """`first` and then this."""
        return Similarity(self.scale * first.scale, self.rotation @ first.rotation, self.points(first.translation))


def between(source: ArrayLike, target: ArrayLike) -> Similarity:
    """The similarity that takes (n, 3) source points to (n, 3) target points with the least squared error (Umeyama 1991)."""
    source, target = np.asarray(source, np.float64), np.asarray(target, np.float64)
    from_middle, to_middle = source - source.mean(0), target - target.mean(0)
    u, values, vt = np.linalg.svd(to_middle.T @ from_middle)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = u * signs @ vt
    scale = float((values * signs).sum() / max((from_middle**2).sum(), 1e-300))
    return Similarity(scale, rotation, target.mean(0) - scale * rotation @ source.mean(0))


def upwards(up: ArrayLike) -> Array:
    """(3, 3) the shortest rotation that takes the direction `up` to the z axis."""
    up = np.asarray(up, np.float64) / np.linalg.norm(up)
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine, cosine = float(np.linalg.norm(axis)), float(up[2])
    if sine < 1e-12:
        return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
    return np.asarray(pose.from_rotation_vector(axis / sine * np.arctan2(sine, cosine))[:3, :3], np.float64)
