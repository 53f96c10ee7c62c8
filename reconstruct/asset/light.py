"""The light around the object, from what its surface mirrors.

A point's specular light is its reflectance times the light of a lobe around the mirrored direction (`sphere`). Reflectance and
light are found in turns: reflectances by least squares for given light (`reflections`), light for given reflectances by the
multiplicative updates of nonnegative least squares (Daube-Witherspoon and Muehllehner 1986; Lee and Seung 2001), whose early
end keeps what lobes blur from being sharpened into noise.

Only products are seen. Two conventions settle the rest: the mean of the light is neutral, so that colour belongs to the
material, and light is as dark as the conservation of energy allows (`BRIGHTEST`).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from koala3d.reconstruct.asset import sphere
from koala3d.reconstruct.asset.reflections import Reflectances, Reflections

ROUNDS, UPDATES = 6, 8
"""Turns of reflectances and light; updates of the light in each."""
HELD_ROUNDS = 2  # rounds in which roughness is the model's
TRUST = 0.003  # see `Reflectances.solved`
BRIGHTEST, PERCENTILE = 0.95, 95.0
"""So many percent of the surface reflect at most this share of the light in any colour, diffuse and mirrored together."""
DARK = 0.3  # points that receive less than this share of the mean light say nothing about the brightest
SMOOTH = 0.02  # weight of the neighbourhood's mean, as a share of the mean weight of the data
KNOWN = 0.05  # share of the mean evidence at which light counts as half known


@dataclass(frozen=True)
class Light:
    """Linear radiance at the nodes of `sphere`, in the world's axes."""

    radiance: Float[np.ndarray, "nodes 3"]
    known: Float[np.ndarray, " nodes"]
    """0..1: how much of what is mirrored from there is seen by cameras. 0: a guess from the directions around."""

    def mirrored(self) -> Float[np.ndarray, "levels nodes 3"]:
        """Light of the lobes."""
        return np.stack([lobe @ self.radiance for lobe in sphere.lobes()]).astype(np.float32)

    def irradiance(
        self, normals: Float[np.ndarray, "n 3"], towards: Float[np.ndarray, "m 3"], is_open: Bool[np.ndarray, "m n"]
    ) -> Float[np.ndarray, "n 3"]:
        """Light that a matte point receives, divided by pi: by which a diffuse colour is its albedo times this.

        Args:
            towards: unit directions that cover the sphere evenly.
            is_open: which of them each point sees.
        """
        received = np.zeros_like(normals)
        for direction, open_here, arriving in zip(towards, is_open, sphere.at(self.radiance, towards), strict=True):
            received += (np.maximum(normals @ direction, 0) * open_here)[:, None] * arriving
        return received * 4 / len(towards)

    def scaled(self, factors: Float[np.ndarray, " 3"]) -> "Light":
        """The same, brighter."""
        return Light(self.radiance * factors, self.known)


@dataclass(frozen=True)
class Unlit:
    """A surface whose light is sought: n points, a part of those that are baked."""

    diffuse: Float[np.ndarray, "n 3"]
    tint: Float[np.ndarray, "n 3"]
    levels: Float[np.ndarray, " n"]
    """The model's roughness as an index into `sphere.ROUGHNESS`."""
    normals: Float[np.ndarray, "n 3"]
    towards: Float[np.ndarray, "m 3"]
    is_open: Bool[np.ndarray, "m n"]
    seen: Bool[np.ndarray, " n"]
    """By enough views to be believed."""


def fit(surface: Unlit, views: list[Reflections], seen: Reflections) -> Light:
    """The light that explains what a surface mirrors. `seen`: the views' reflections joined.

    Where nothing is mirrored the light is even and white, and known nowhere.
    """
    count = len(sphere.nodes())
    if not len(seen.point) or not np.any(seen.light > 1e-4):
        return _settled(Light(np.ones((count, 3)), np.zeros(count)), surface, np.zeros_like(surface.diffuse))
    reflectance, best = np.maximum(surface.tint, 1e-3), np.rint(surface.levels).astype(np.int64)
    light = Light(np.full((count, 3), seen.light.mean() / reflectance.mean()), np.zeros(count))
    for turn in range(ROUNDS):
        light = _light(light, seen, reflectance, best)
        sums = Reflectances(len(reflectance), light.mirrored())
        for view in views:
            sums.add(view)
        reflectance, best, _ = sums.solved(surface.tint, surface.levels, trust=TRUST, held=turn < HELD_ROUNDS)
        before = light.radiance
        light = _settled(light, surface, reflectance)
        reflectance = np.maximum(reflectance * (before.mean(0) / light.radiance.mean(0)), 1e-4)
    return light


def _light(light: Light, seen: Reflections, reflectance: Float[np.ndarray, "n 3"], best: Int[np.ndarray, " n"]) -> Light:
    """Better light for given reflectances and roughnesses."""
    lobes, nodes = sphere.lobes(), len(light.radiance)
    factor = reflectance[seen.point] * (1 - seen.grazing) + seen.grazing
    # Sums over all reflections of one roughness from one node: weights, and weights times the light that would be mirrored.
    place = (best[seen.point][:, None] * nodes + seen.node).reshape(-1)
    size = len(lobes) * nodes

    def summed(values: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "levels nodes 3"]:
        spread = values[:, None] * seen.share[..., None]
        columns = [np.bincount(place, spread[..., k].reshape(-1), size) for k in range(3)]
        return np.stack(columns, -1).reshape(len(lobes), nodes, 3).astype(np.float32)

    weights, targets = summed(seen.weight * factor**2), summed(seen.weight * factor * seen.light)
    used = [level for level in range(len(lobes)) if weights[level].any()]
    pull = SMOOTH * weights.sum(0).mean()
    wide = lobes[sphere.ROUGHNESS.index(0.5)]
    radiance = np.maximum(light.radiance, 1e-4).astype(np.float32)
    wanted = sum(lobes[level].T @ targets[level] for level in used)
    for _ in range(UPDATES):
        explained = sum(lobes[level].T @ (weights[level] * (lobes[level] @ radiance)) for level in used)
        radiance = radiance * (wanted + pull * (wide @ radiance)) / (explained + pull * radiance + 1e-12)
    evidence = sum((lobes[level] ** 2).T @ weights[level].mean(-1) for level in used)
    return Light(radiance.astype(np.float64), evidence / (evidence + KNOWN * evidence.mean()))


def _settled(light: Light, surface: Unlit, reflectance: Float[np.ndarray, "n 3"]) -> Light:
    """The same with a neutral mean, and no brighter than energy demands."""
    weight = light.known[:, None] if light.known.any() else np.ones((len(light.known), 1))
    mean = np.sum(light.radiance * weight, 0) / weight.sum()
    neutral = light.scaled(mean.mean() / np.maximum(mean, 1e-9))
    reflectance = reflectance * np.maximum(mean, 1e-9) / mean.mean()
    received = neutral.irradiance(surface.normals, surface.towards, surface.is_open)
    lit = surface.seen & (received.min(-1) > DARK * received.mean())
    share = (surface.diffuse[lit] / received[lit] + reflectance[lit]).max(-1) if lit.any() else np.array([BRIGHTEST])
    return neutral.scaled(np.full(3, max(np.percentile(share, PERCENTILE), 1e-3) / BRIGHTEST))
