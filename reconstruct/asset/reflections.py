"""What cameras see mirrored: for points of the surface and the views that see them, the model's specular light.

Schlick's reflectance F0 + (1 - F0) g with g = (1 - n . v)^5 is linear in F0, the reflectance towards the normal.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from koala3d.reconstruct.asset import sphere
from koala3d.reconstruct.asset.material_samples import MaterialSamples, Shader

FLATTEST = 0.25  # cosine below which a view is too flat to measure a reflectance


@dataclass(frozen=True)
class Reflections:
    """n pairs of a point and a view that sees it."""

    point: Int[np.ndarray, " n"]
    node: Int[np.ndarray, "n near"]
    """Nodes of the sphere around the direction that is mirrored."""
    share: Float[np.ndarray, "n near"]
    grazing: Float[np.ndarray, "n 1"]
    """Schlick's g."""
    weight: Float[np.ndarray, "n 1"]
    """Cosine of the view: flat views see more surface in a pixel."""
    light: Float[np.ndarray, "n 3"]
    """Linear."""

    def lookup(self, values: Float[np.ndarray, "nodes channels"]) -> Float[np.ndarray, "n channels"]:
        """Values of nodes in the mirrored directions."""
        return sum(values[self.node[:, k]] * self.share[:, k, None] for k in range(self.node.shape[1]))

    @classmethod
    def none(cls) -> "Reflections":
        """Of a surface that mirrors nothing."""
        near = np.zeros((0, sphere.NEAREST))
        column = np.zeros((0, 1))
        return cls(np.zeros(0, np.int64), near.astype(np.int64), near, column, column, np.zeros((0, 3)))


def reflections(
    shader: Shader, samples: MaterialSamples, seen: Bool[np.ndarray, " points"], rays: Float[np.ndarray, "points 3"]
) -> Reflections:
    """Of one view, by which points it sees and its unit rays to all points."""
    cosine = -np.sum(samples.normals * rays, -1)
    point = np.flatnonzero(seen & (cosine > FLATTEST))
    facing, rays = cosine[point][:, None], rays[point]
    node, share = sphere.nearest_nodes(2 * facing * samples.normals[point] + rays)
    light = shader.specular(point, rays.astype(np.float32))
    return Reflections(point, node, share.astype(np.float32), (1 - facing) ** 5, facing, np.maximum(light, 0))


def joined(parts: list[Reflections]) -> Reflections:
    """All of them as one."""
    fields = ("point", "node", "share", "grazing", "weight", "light")
    return Reflections(*(np.concatenate([getattr(part, name) for part in parts]) for name in fields))


class Reflectances:
    """Reflectance and roughness of points, by least squares from reflections and the light.

    Sums over views, so that views can be added one after another; there is one set for each of `sphere.ROUGHNESS`.
    """

    def __init__(self, count: int, mirrored: Float[np.ndarray, "levels nodes 3"]) -> None:
        self._mirrored = mirrored
        levels = len(mirrored)
        self._products, self._squares, self._errors = (np.zeros((levels, count, 3), np.float32) for _ in range(3))
        self._total = np.zeros((count, 3), np.float32)

    def add(self, seen: Reflections) -> None:
        """Add reflections; a point may be in them only once."""
        point = seen.point
        for level, values in enumerate(self._mirrored):
            received = seen.lookup(values)
            rest, slope = seen.light - seen.grazing * received, (1 - seen.grazing) * received
            self._products[level, point] += seen.weight * rest * slope
            self._squares[level, point] += seen.weight * slope**2
            self._errors[level, point] += seen.weight * rest**2
        self._total[point] += seen.weight * seen.light**2

    def solved(
        self, prior: Float[np.ndarray, "n 3"], levels: Float[np.ndarray, " n"], *, trust: float, held: bool = False
    ) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Reflectance, index of the roughness, and the share of the light that they leave unexplained (1 where nothing is seen).

        Args:
            prior: reflectance of points that no view sees, up to a factor for each colour that is fitted here.
            levels: the model's roughness, as an index that need not be whole.
            trust: share of unexplained light for which the roughness may be one index away from the model's.
            held: keep the model's roughness.
        """
        seen = self._total.sum(-1) > 0
        near = np.clip(np.rint(levels), 0, len(self._mirrored) - 1).astype(np.int64)
        everyone = np.arange(len(near))
        products, squares = self._products[near, everyone], self._squares[near, everyone]
        factor = np.sum(products * prior, 0) / np.maximum(np.sum(squares * prior**2, 0), 1e-12)
        expected = prior * factor
        weak = 0.02 * (squares[seen].mean() if seen.any() else 1.0)  # so much light pulls a point to its prior
        found = (self._products + weak * expected) / (self._squares + weak)
        found = np.maximum(found, 0)
        left = self._errors - 2 * found * self._products + found**2 * self._squares
        left = np.maximum(left.sum(-1), 0) / np.maximum(self._total.sum(-1), 1e-12)
        apart = np.arange(len(self._mirrored))[:, None] - levels
        best = near if held else np.argmin(np.where(seen, left, 0) + trust * apart**2, axis=0)
        return found[best, everyone], best, np.where(seen, left[best, everyone], 1.0)

    def share(self, left: Float[np.ndarray, " n"]) -> float:
        """Mean of a share of the points' light, weighted by that light; 0 where there is none."""
        light = self._total.sum(-1)
        return float(np.sum(left * light) / max(light.sum(), 1e-12))
