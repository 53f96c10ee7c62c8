"""Views of a near scene: shape by tracing rays against its solids, light by Mitsuba's paths to meshes of them."""

import zlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.mitsuba_variant import variant
from koala3d.reconstruct.path_tracing.stage import TRIAL
from koala3d.reconstruct.rendered.near.scenes import NearScene
from koala3d.reconstruct.rendered.shiny import CHROME, RADIUS_M
from koala3d.reconstruct.rendered.surfaces import surface_of
from koala3d.reconstruct.rendered.tracer import Body, Tracer
from koala3d.reconstruct.rendered.views import FineRays, Maps, averaged, fine_camera

CELLS = 256
"""Cells per axis of the grid that a part's mesh is taken from: 0.9 mm."""


@dataclass(frozen=True)
class Lit:
    """A scene under near lamps."""

    scene: NearScene
    tracer: Tracer
    cells: int = CELLS
    using: str | None = None
    """Variant of Mitsuba; None: the fastest that works."""

    @cached_property
    def _renderer(self) -> Any:
        using = self.using or variant(TRIAL)  # before Mitsuba is imported, which loads LLVM

        from koala3d.reconstruct.rendered.near.renderer import Mesh, Renderer

        alone = (Tracer((Body(part.solid, CHROME),), self.scene.room) for part in self.scene.parts)
        meshes = tuple(Mesh(*surface_of(tracer, self.cells)) for tracer in alone)
        return Renderer(self.scene, meshes, using=using)

    def maps(
        self, camera: Camera, world_from_camera: NDArray[np.float64], lamps_from_scene: NDArray[np.float64] | None = None
    ) -> Maps:
        """See `Views`; the lamps stand still with the scene."""
        assert lamps_from_scene is None, "near lamps stand still with the scene"
        rays, fine = FineRays.of(camera, world_from_camera), fine_camera(camera)
        t = self.tracer.cast(rays.origins, rays.directions)
        hit = np.flatnonzero(t > 0)
        points = rays.origins[hit] + t[hit, None] * rays.directions[hit]
        part, normals = np.full(len(t), -1), np.zeros((len(t), 3), np.float32)
        part[hit], normals[hit] = self.tracer.nearest(points), self.tracer.measured(points)[1]
        scene_from_camera = world_from_camera.copy()
        scene_from_camera[:3, 3] /= RADIUS_M
        seed = zlib.crc32(world_from_camera.astype(np.float32).tobytes())  # another noise in each view, the same every time
        shown = self._renderer.parts_of_light(fine, scene_from_camera, part.reshape(fine.height, fine.width), seed=seed)
        diffuse, specular = (np.where((t > 0)[:, None], light.reshape(-1, 3), 0) for light in shown)
        return averaged({"t": t, "normals": normals, "diffuse": diffuse, "specular": specular}, rays, camera)
