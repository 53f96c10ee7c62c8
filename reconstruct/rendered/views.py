"""What a camera sees of a scene: its light in parts, depth and normals, each pixel the mean of a few rays."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.reconstruct.rendered.shiny import RADIUS_M
from koala3d.reconstruct.rendered.tracer import Tracer

DISTANCE_M = 0.6
"""Distance of the cameras from the centre."""
HALF_FIELD = 0.118
"""Half the width of the field of view at the centre [m]."""
SAMPLES = 3  # rays per pixel along each axis
Maps = dict[str, NDArray[np.float32]]


class Views(Protocol):
    """A scene that can be looked at."""

    def maps(
        self, camera: Camera, world_from_camera: NDArray[np.float64], lamps_from_scene: NDArray[np.float64] | None = None
    ) -> Maps:
        """Maps (height, width, channels), each pixel the mean of `SAMPLES` squared rays.

        "alpha", "depth" along z [m] and unit "normals" of the hit; "diffuse" and "specular" linear, premultiplied with alpha.

        Args:
            lamps_from_scene: (4, 4) where the lamps stand, in the tracer's unit; None: where the scene does.
        """
        ...


def camera_of(size: int) -> Camera:
    """A pinhole camera whose field of view is `HALF_FIELD` to each side at `DISTANCE_M`."""
    focal = 0.5 * size * DISTANCE_M / HALF_FIELD
    return Camera(size, size, focal, focal, size / 2, size / 2)


@dataclass(frozen=True)
class FineRays:
    """All rays of a picture, in the tracer's unit: (n, 3) origins and unit directions."""

    origins: NDArray[np.float64]
    directions: NDArray[np.float64]
    per_depth: NDArray[np.float64]
    """(n,) Distance along each ray per depth along z."""

    @classmethod
    def of(cls, camera: Camera, world_from_camera: NDArray[np.float64]) -> "FineRays":
        """Those of a picture with `SAMPLES` times as many pixels along each axis."""
        fine = fine_camera(camera)
        in_camera = fine.directions(fine.pixel_centres()).reshape(-1, 3)
        per_depth = np.linalg.norm(in_camera, axis=-1)
        directions = (in_camera / per_depth[:, None]) @ world_from_camera[:3, :3].T
        origins = np.broadcast_to(world_from_camera[:3, 3] / RADIUS_M, directions.shape)
        return cls(origins, directions, per_depth)


def fine_camera(camera: Camera) -> Camera:
    """The camera of a picture with `SAMPLES` times as many pixels along each axis."""
    return camera.scaled(SAMPLES * camera.width, SAMPLES * camera.height)


@dataclass(frozen=True)
class Traced:
    """A scene under lamps whose reflections have a closed form."""

    tracer: Tracer

    def maps(
        self, camera: Camera, world_from_camera: NDArray[np.float64], lamps_from_scene: NDArray[np.float64] | None = None
    ) -> Maps:
        """See `Views`."""
        rays = FineRays.of(camera, world_from_camera)
        found = self.tracer.look(rays.origins, rays.directions, lamps_from_scene)
        return averaged(found, rays, camera)


def averaged(found: dict[str, NDArray], rays: FineRays, camera: Camera) -> Maps:
    """Maps of a picture from what its rays found.

    Args:
        found: "t" (n,) distance of the hit [radius of the scene], 0 for none; "normals", "diffuse", "specular" (n, 3).
    """
    depth = RADIUS_M * found["t"] / rays.per_depth
    values = {**found, "depth": depth, "alpha": (depth > 0).astype(np.float32)}
    maps = {name: _mean(values[name], camera) for name in ("alpha", "depth", "normals", "diffuse", "specular")}
    maps["depth"] = maps["depth"] / np.maximum(maps["alpha"], 1e-6)
    length = np.linalg.norm(maps["normals"], axis=-1, keepdims=True)
    maps["normals"] = np.where(length > 1e-3, maps["normals"] / np.maximum(length, 1e-3), 0)
    return {name: values.astype(np.float32) for name, values in maps.items()}


def _mean(values: NDArray, camera: Camera) -> NDArray[np.float64]:
    """(height, width, channels) mean of values over the rays of each pixel."""
    grid = values.reshape(camera.height, SAMPLES, camera.width, SAMPLES, -1)
    return grid.mean((1, 3), dtype=np.float64)
