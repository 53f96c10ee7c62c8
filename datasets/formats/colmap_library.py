"""What is left to pycolmap, imported where it is used: writing models, and lenses that our camera cannot hold."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats.export import moved
from koala3d.datasets.scene import Scene, View

POINTWISE = ("FOV", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION", "DIVISION", "EUCM")
"""Lens models of the library that have a pinhole's parameters first and bend the rays of one."""


@dataclass(frozen=True)
class LibraryCamera(Camera):
    """A camera with a lens of COLMAP's that `Camera` cannot hold. Images are resampled from it; nothing else knows it."""

    model: str = ""
    bend: tuple[float, ...] = ()
    """Parameters of the lens after focal lengths and centre."""

    @property
    def is_pinhole(self) -> bool:
        """False: there is a lens."""
        return False

    def distort(self, normalised: ArrayLike) -> NDArray[np.float64]:
        """(..., 2) ideal normalised coordinates to (..., 2) distorted ones; NaN where the lens has none."""
        ideal = np.asarray(normalised, np.float64)
        rays = np.concatenate([ideal, np.ones((*ideal.shape[:-1], 1))], axis=-1).reshape(-1, 3)
        return np.asarray(self._lens.img_from_cam(rays)).reshape(ideal.shape)

    def undistort(self, distorted: ArrayLike) -> NDArray[np.float64]:
        """Inverse of `distort`."""
        bent = np.asarray(distorted, np.float64)
        return np.asarray(self._lens.cam_from_img(bent.reshape(-1, 2))).reshape(bent.shape)

    def checked(self, *, where: object) -> Self:
        """This camera if its values are possible; else a DatasetError."""
        self.undistorted().checked(where=where)
        if not np.isfinite(self.bend).all():
            raise DatasetError("camera holds a value that is not finite", where=where, why=str(self.bend))
        return self

    @cached_property
    def _lens(self) -> Any:
        """The lens in normalised coordinates: with a focal length of 1."""
        import pycolmap

        focal = [1.0] if self.model.startswith("SIMPLE_") else [1.0, 1.0]
        return pycolmap.Camera(camera_id=1, model=self.model, width=2, height=2, params=[*focal, 0.0, 0.0, *self.bend])


def camera(model: str, size: tuple[int, int], parameters: tuple[float, ...], *, where: object) -> LibraryCamera:
    """The camera of a lens model in `POINTWISE`, from its size and COLMAP's parameters."""
    single = model.startswith("SIMPLE_")
    fx, fy, cx, cy = (parameters[0], *parameters[:3]) if single else parameters[:4]
    bend = tuple(float(value) for value in parameters[3 if single else 4 :])
    return LibraryCamera(*size, fx, fy, cx, cy, model=model, bend=bend).checked(where=where)


def write_model(scene: Scene, views: list[View], folder: Path, *, text: bool) -> None:
    """Write the three files of a model, and those of COLMAP 4, for views as exported."""
    import pycolmap

    model = pycolmap.Reconstruction()
    cameras = {camera: number for number, camera in enumerate(dict.fromkeys(view.camera for view in views), 1)}
    for camera, number in cameras.items():
        kind, values = lens_of(camera)
        stored = pycolmap.Camera(camera_id=number, model=kind, width=camera.width, height=camera.height, params=values)
        model.add_camera_with_trivial_rig(stored)
    features = _features(scene, views)
    for number, view in enumerate(views, 1):
        image = pycolmap.Image(view.image.name, features[number][1], cameras[view.camera], number)
        camera_from_world = pycolmap.Rigid3d(pose.inverse(view.world_from_camera)[:3])
        model.add_image_with_trivial_frame(image, camera_from_world)
    tracks: dict[int, list[tuple[int, int]]] = {}
    for number, (points, _) in features.items():
        for place, point in enumerate(points):
            tracks.setdefault(int(point), []).append((number, place))
    if scene.points is not None:
        colours = np.zeros((len(scene.points), 3), np.uint8) if scene.colours is None else scene.colours
        for point, xyz in enumerate(scene.points):
            track = pycolmap.Track([pycolmap.TrackElement(*element) for element in tracks.get(point, [])])
            model.add_point3D(xyz, track, colours[point])
        model.update_point_3d_errors()
    folder.mkdir(parents=True)
    (model.write_text if text else model.write_binary)(folder)


def _features(scene: Scene, views: list[View]) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Per image number, from 1: (k,) points that it saw and (k, 2) their pixels in the picture as exported."""
    sightings = scene.sightings
    if sightings is None or scene.points is None:
        return {number: (np.zeros(0, np.int64), np.zeros((0, 2))) for number in range(1, len(views) + 1)}
    numbers = {name: index for index, name in enumerate(sightings.names)}
    found = {}
    for number, (old, view) in enumerate(zip(scene.views, views, strict=True), 1):
        rows = np.flatnonzero(sightings.index[:, 1] == numbers.get(view.name, -1))
        pixels = moved(old, view, sightings.pixels[rows])
        inside = ((pixels >= 0) & (pixels <= [view.camera.width, view.camera.height])).all(1) | (old.camera == view.camera)
        found[number] = (sightings.index[rows[inside], 0], pixels[inside])
    return found


def lens_of(camera: Camera) -> tuple[str, list[float]]:
    """The simplest lens model that represents a camera, and its parameters."""
    straight = [camera.fx, camera.fy, camera.cx, camera.cy]
    if camera.is_pinhole:
        return "PINHOLE", straight
    if camera.fisheye:
        return "OPENCV_FISHEYE", [*straight, camera.k1, camera.k2, camera.k3, camera.k4]
    bent, higher = [*straight, camera.k1, camera.k2, camera.p1, camera.p2], [camera.k3, camera.k4, camera.k5, camera.k6]
    return ("FULL_OPENCV", bent + higher) if any(higher) else ("OPENCV", bent)
