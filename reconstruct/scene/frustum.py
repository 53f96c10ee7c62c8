"""The space of scenes whose cameras all look the same way: what they see together, straightened."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.scene import View
from koala3d.datasets.structure.bounds import half_field
from koala3d.reconstruct.scene import contraction
from koala3d.reconstruct.scene.space import Coordinate, Points, Space

Vector = tuple[float, float, float]

WIDEST = 2.0
"""Largest width as a multiple of what one camera sees: beyond, most of the frustum is what few cameras see."""


@dataclass(frozen=True)
class Frustum(Space):
    """A pyramid with its top behind all cameras, straightened: across by directions, along by disparity.

    With (u, v, w) = rotation (x - origin), the map is

        (u / w, v / w) / across    and    deep (1 - 2 (1/w - 1/far) / (1/near - 1/far)),

    perspective as normalised device coordinates are (NeRF, Mildenhall et al. 2020, appendix C): straight lines stay straight,
    a pixel is as wide near as it is far, and a step in depth is as long as the parallax that it makes.
    """

    rotation: tuple[Vector, Vector, Vector]
    """Rows: the frustum's axes in the scene."""
    origin: Vector
    """[scene unit]"""
    across: float
    """Largest tangent to the axis that any camera sees."""
    deep: float
    """Half the map's extent along the axis: parallax between the outermost cameras in the same unit as `across`, at most 1."""
    near: float
    """Smallest w that any camera sees [scene unit]."""
    far: float
    """Largest one."""

    def mapped(self, points: Points) -> Points:
        """As above; nearer than half of `near` everything is mapped as if it were there."""
        return jnp.stack(self.mapped_coordinates(points[..., 0], points[..., 1], points[..., 2]), -1)

    def mapped_coordinates(self, x: Coordinate, y: Coordinate, z: Coordinate) -> tuple[Coordinate, Coordinate, Coordinate]:
        """`mapped` of three arrays."""
        u, v, disparity = self._turned(x, y, z)
        share = disparity / self.across
        return u * share, v * share, self.deep - self.slope * (disparity - 1 / self.far)

    def scale(self, points: Points) -> Coordinate:
        """That across the axis: samples are narrow beside the distance over which disparity changes."""
        return self._turned(points[..., 0], points[..., 1], points[..., 2])[2] / self.across

    def pull_back(self, points: Points, gradient: Points) -> Points:
        """By the chain rule through u, v and w."""
        u, v, disparity = self._turned(points[..., 0], points[..., 1], points[..., 2])
        share = disparity / self.across
        du, dv = gradient[..., 0] * share, gradient[..., 1] * share
        dw = disparity * (disparity * self.slope * gradient[..., 2] - u * du - v * dv)
        return jnp.stack([du, dv, dw], -1) @ jnp.asarray(self.rotation, jnp.float32)

    def around(self, points: Points) -> Points:
        """Those of the `Ball`."""
        return contraction.contract(points)

    def scene_points(self, mapped: NDArray[np.float64]) -> NDArray[np.float64]:
        """(..., 3) scene points of mapped ones: the inverse map."""
        w = 1 / (1 / self.far + (self.deep - np.clip(mapped[..., 2], -self.deep, self.deep)) / self.slope)
        local = np.stack([mapped[..., 0] * self.across * w, mapped[..., 1] * self.across * w, w], -1)
        return local @ np.asarray(self.rotation) + self.origin

    def length_along(self, mapped: NDArray[np.float64]) -> NDArray[np.float64]:
        """(...) length along the axis [scene unit] per unit of the map, at mapped points."""
        return ((self.scene_points(mapped) - self.origin) @ np.asarray(self.rotation[2])) ** 2 / self.slope

    @property
    def slope(self) -> float:
        """Map's unit per disparity."""
        return 2 * self.deep / (1 / self.near - 1 / self.far)

    @property
    def smallest(self) -> float:
        """w of everything nearer: what is behind the top would be mapped to the other side."""
        return 0.5 * self.near

    def _turned(self, x: Coordinate, y: Coordinate, z: Coordinate) -> tuple[Coordinate, Coordinate, Coordinate]:
        """u, v and 1 / w."""
        x, y, z = x - self.origin[0], y - self.origin[1], z - self.origin[2]
        u, v, w = (row[0] * x + row[1] * y + row[2] * z for row in self.rotation)
        return u, v, 1 / jnp.maximum(w, self.smallest)

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> "Frustum":
        """From `dataclasses.asdict` and JSON."""
        x, y, z = (tuple(row) for row in content["rotation"])
        return cls(**{**content, "rotation": (x, y, z), "origin": tuple(content["origin"])})


def frustum_of(views: tuple[View, ...], centre: Vector, scale: float, near: float, far: float) -> Frustum | None:
    """The frustum that holds all that the views see between two depths; None where they do not look the same way.

    Args:
        centre: of the scene [world unit], with `scale` scene units per world unit.
        near: [scene unit], as `far`.
    """
    matrices = np.stack([view.world_from_camera for view in views])
    positions = (matrices[:, :3, 3] - centre) * scale
    forward, down = _unit(matrices[:, :3, 2].mean(0)), matrices[:, :3, 1].mean(0)
    down = _unit(down - forward * (down @ forward))
    rotation = np.stack([np.cross(down, forward), down, forward])
    local = (positions - positions.mean(0)) @ rotation.T
    rearmost = local[:, 2].min()
    origin = positions.mean(0) + forward * rearmost
    corners = []
    for view, position in zip(views, positions, strict=True):
        width, height = view.camera.width, view.camera.height
        rays = view.camera.directions([[0, 0], [width, 0], [0, height], [width, height]]) @ view.world_from_camera[:3, :3].T
        corners.append((position + np.concatenate([rays * near, rays * far]) - origin) @ rotation.T)
    seen = np.concatenate(corners)
    if seen[:, 2].min() <= 0.25 * near:  # some look across the others
        return None
    across = float(np.abs(seen[:, :2] / seen[:, 2:]).max())
    if across > WIDEST * max(half_field(view.camera) for view in views):
        return None
    first, last = float(seen[:, 2].min()), float(seen[:, 2].max())
    spread = float(np.linalg.norm(np.ptp(local[:, :2], axis=0)))
    deep = min(1.0, spread * (1 / first - 1 / last) / 2 / across)
    rows = tuple((float(r[0]), float(r[1]), float(r[2])) for r in rotation)
    return Frustum((rows[0], rows[1], rows[2]), (float(origin[0]), float(origin[1]), float(origin[2])), across, deep, first, last)


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)
