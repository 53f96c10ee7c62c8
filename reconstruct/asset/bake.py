"""From a trained model and a mesh of it to values at texels: diffuse albedo, reflectance, roughness, normals, occlusion,
certainty."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from koala3d.datasets import pose
from koala3d.datasets.core.console import progress
from koala3d.reconstruct.asset import light as light_module
from koala3d.reconstruct.asset import sphere
from koala3d.reconstruct.asset.certainty import ENOUGH, Certainty, Sightings
from koala3d.reconstruct.asset.light import Light, Unlit
from koala3d.reconstruct.asset.material_samples import MaterialSamples, Shader, sample_material
from koala3d.reconstruct.asset.reflections import Reflectances, Reflections, joined, reflections
from koala3d.reconstruct.output.mesh import visibility
from koala3d.reconstruct.output.trained_model import TrainedModel

LIGHT_POINTS = 8000  # points of the surface from which the light is found
DARKEST = 0.1  # share of the surface's mean light below which a diffuse colour cannot be told from an albedo


@dataclass(frozen=True)
class Baked:
    """n points of a surface in the light that was found."""

    albedo: Float[np.ndarray, "n 3"]
    """Linear, 0..1: share of the light that is scattered in all directions."""
    reflectance: Float[np.ndarray, "n 3"]
    """Linear, 0..1: share of the light that is mirrored towards the normal's direction (F0)."""
    roughness: Float[np.ndarray, " n"]
    """The square root of GGX's alpha, as glTF has it."""
    normals: Float[np.ndarray, "n 3"]
    """Unit, world frame."""
    occlusion: Float[np.ndarray, " n"]
    """0..1: share of the sky above the point, weighted by cosine, that the object itself leaves open."""
    certainty: Certainty
    unexplained: float
    """Share of the energy of the model's specular light that reflectance, roughness and light do not explain."""


class Surface:
    """Points on a model's surface with all that is known of them before the light is."""

    def __init__(self, trained: TrainedModel, points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]) -> None:
        self.trained, self.points, self.normals = trained, points, normals
        self.samples: MaterialSamples = sample_material(trained, points, normals)
        self.towards = pose.directions(visibility.DIRECTIONS)
        self.is_open = visibility.open_to(points, normals, self.towards)
        self.shines = hasattr(trained.model.field.appearance, "view")

    @property
    def levels(self) -> Float[np.ndarray, " n"]:
        """The model's roughness as an index into `sphere.ROUGHNESS`: a lobe of GGX's alpha is about as wide as one of von Mises
        and Fisher of concentration 1 / (2 alpha^2) (Wang et al. 2009, "All-Frequency Rendering of Dynamic, Spatially-Varying
        Reflectance", section 3.2), and the model's roughness is the inverse of that."""
        roughness = (np.maximum(self.samples.roughness, 0) / 2) ** 0.25
        return np.interp(roughness, sphere.ROUGHNESS, np.arange(len(sphere.ROUGHNESS)))

    def light(self) -> Light:
        """The light around the object, see `light.fit`."""
        chosen = np.random.default_rng(0).permutation(len(self.points))[:LIGHT_POINTS]
        part = self.samples.rows(chosen)
        views, shader, counts = [], Shader(self.trained, part), np.zeros(len(chosen), np.int64)
        for seen, rays in self._sightings("finding the light"):
            counts += seen[chosen]
            if self.shines:
                views.append(reflections(shader, part, seen[chosen], rays[chosen]))
        known = (self.levels[chosen], part.normals, self.towards, self.is_open[:, chosen], counts >= ENOUGH)
        surface = Unlit(part.diffuse, part.tint, *known)
        return light_module.fit(surface, views, joined(views) if views else Reflections.none())

    def baked(self, light: Light) -> Baked:
        """The material at all points under a light."""
        sums, sightings = Reflectances(len(self.points), light.mirrored()), Sightings(len(self.points))
        shader = Shader(self.trained, self.samples)
        for seen, rays in self._sightings("measuring reflectances"):
            sightings.add(seen, -np.sum(self.normals * rays, -1), rays)
            if self.shines:
                sums.add(reflections(shader, self.samples, seen, rays))
        reflectance, level, left = sums.solved(self.samples.tint, self.levels, trust=light_module.TRUST)
        received = light.irradiance(self.samples.normals, self.towards, self.is_open)
        received = np.maximum(received, DARKEST * received.mean(0))
        cosines = np.maximum(self.towards @ self.normals.T, 0)
        albedo, roughness = np.clip(self.samples.diffuse / received, 0, 1), np.asarray(sphere.ROUGHNESS)[level]
        reflectance = np.clip(reflectance, 0, 1) if self.shines else np.zeros_like(albedo)
        certainty, normals = sightings.certainty(), self.samples.normals
        if (certainty.views == 0).any() and certainty.views.any():
            nearest = self._nearest_seen(certainty)
            albedo, reflectance, roughness = albedo[nearest], reflectance[nearest], roughness[nearest]
            normals = np.where((certainty.views > 0)[:, None], normals, self.normals)
        cosines = np.maximum(self.towards @ self.normals.T, 0)
        sky = np.sum(cosines * (cosines > visibility.GRAZING), 0)
        occlusion = np.sum(cosines * self.is_open, 0) / np.maximum(sky, 1e-9)
        return Baked(albedo, reflectance, roughness, normals, occlusion, certainty, sums.share(left))

    def _nearest_seen(self, certainty: Certainty) -> Int[np.ndarray, " n"]:
        """For each point the nearest that a view sees: itself, where one does."""
        from scipy.spatial import KDTree

        seen = np.flatnonzero(certainty.views > 0)
        return seen[KDTree(self.points[seen]).query(self.points)[1]]

    def _sightings(self, title: str):
        views = self.trained.scene.split("train")
        with progress(title, len(views), "views") as shown:
            for found in visibility.seen_from(self.points, self.normals, views):
                yield found
                shown.advance()
