"""Lens models of other programs: the camera itself if a model holds it, else the nearest camera that it holds."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from koala3d.calib.intrinsics import over_image
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError

FURTHEST_PX = 0.1
"""A nearest camera may be off by this much, which is about what a corner of a target is found to; else nothing is written."""
CELLS = 32  # the grid over the image on which cameras are compared


@dataclass(frozen=True)
class Model:
    """A distortion model by the name that a format has for it."""

    name: str
    coefficients: tuple[str, ...]
    """In the order of the format."""
    fisheye: bool = False

    def holds(self, camera: Camera) -> bool:
        """Whether it describes the camera exactly."""
        lens = dict(zip(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), camera.distortion, strict=True))
        others = any(value for name, value in lens.items() if name not in self.coefficients)
        return camera.spline is None and camera.fisheye == self.fisheye and not others

    def values(self, camera: Camera) -> list[float]:
        """The coefficients of a camera that it holds."""
        return [float(getattr(camera, name)) for name in self.coefficients]


BROWN4 = ("k1", "k2", "p1", "p2")
BROWN5 = (*BROWN4, "k3")
RATIONAL = (*BROWN5, "k4", "k5", "k6")
FISHEYE = ("k1", "k2", "k3", "k4")


@dataclass(frozen=True)
class Held:
    """A camera as a format holds it."""

    model: Model
    camera: Camera
    most_px: float
    """Largest distance between where it and the calibrated camera see the same ray [px]; 0 if it is the same."""

    def notes(self) -> list[str]:
        """What is said about it in the file."""
        found = [
            f"Intrinsics are for images of {self.camera.width} x {self.camera.height} pixels; (0, 0) is the centre of the first."
        ]
        if self.most_px:
            found.append(
                f"The model {self.model.name} cannot hold this lens; its nearest one is at most {self.most_px:.4f} px off."
            )
        return found


def held(camera: Camera, models: Sequence[Model], title: str) -> Held:
    """The camera with the first model that holds it, else with the one that comes closest.

    Raises DatasetError: no camera of these models is as close as `FURTHEST_PX`.
    """
    for model in models:
        if model.holds(camera):
            return Held(model, camera, 0.0)
    tried = [_nearest(camera, model) for model in models if model.fisheye == camera.fisheye]
    best = min(tried, key=lambda one: one.most_px)
    if best.most_px > FURTHEST_PX:
        why = f"the nearest lens that it holds, {best.model.name}, is {best.most_px:.2f} px off"
        remedy = "calibrate with another --lens, or export to a format that holds it: opencv and ros hold most"
        raise DatasetError(f"{title} cannot hold this lens", where="camera", why=why, remedy=remedy)
    return best


def _nearest(camera: Camera, model: Model) -> Held:
    """The camera of a model that sees the same rays at nearly the same pixels, by least squares over the image."""
    _, _, pixels = over_image.cells(camera, CELLS, CELLS)
    rays = camera.directions(pixels[camera.valid(pixels)])
    seen = camera.project(rays)
    names = ("fx", "fy", "cx", "cy", *model.coefficients)
    start = np.array([getattr(camera, name) for name in names])
    scale = np.array([camera.fx, camera.fy, camera.fx, camera.fy, *(1.0 for _ in model.coefficients)])
    bare = replace(camera, spline=None, k1=0.0, k2=0.0, p1=0.0, p2=0.0, k3=0.0, k4=0.0, k5=0.0, k6=0.0)

    def camera_of(vector: np.ndarray) -> Camera:
        return replace(bare, **dict(zip(names, map(float, vector * scale), strict=True)))

    def off(vector: np.ndarray) -> np.ndarray:
        return (camera_of(vector).project(rays) - seen).ravel()

    found = camera_of(least_squares(off, start / scale, x_scale="jac").x)
    return Held(model, found, float(np.linalg.norm(found.project(rays) - seen, axis=-1).max()))
