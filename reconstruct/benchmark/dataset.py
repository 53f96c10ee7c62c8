"""Data of NerfBaselines as scenes of Koala.

Its poses are world_from_camera with OpenCV's axes, and its first pixel's centre is (0.5, 0.5): both as here. Distortion is
k1 k2 p1 p2 k3 k4 k5 k6 for all models; `opencv` uses the first four, `opencv_fisheye` k1 k2 k3 k4.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.formats import assemble
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.structure.measure import measured

MODELS = ("pinhole", "opencv", "opencv_fisheye", "full_opencv")
"""Camera models in NerfBaselines' order, which numbers them."""
USED = {
    "pinhole": (),
    "opencv": ("k1", "k2", "p1", "p2"),
    "opencv_fisheye": ("k1", "k2", "k3", "k4"),
    "full_opencv": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def camera_of(cameras: Any) -> tuple[Camera, NDArray[np.float64]]:
    """Intrinsics, and (4, 4) world_from_camera, of NerfBaselines' `Cameras` with one camera in it."""
    fx, fy, cx, cy = map(float, np.asarray(cameras.intrinsics).reshape(4))
    width, height = map(int, np.asarray(cameras.image_sizes).reshape(2))
    name = MODELS[int(np.asarray(cameras.camera_models).item())]
    given = dict(zip(ORDER, map(float, np.asarray(cameras.distortion_parameters).ravel()), strict=False))
    lens: dict[str, Any] = {key: given.get(key, 0.0) for key in USED[name]}
    camera = Camera(width, height, fx, fy, cx, cy, fisheye=name == "opencv_fisheye", **lens)
    matrix = np.vstack([np.asarray(cameras.poses, np.float64).reshape(3, 4), [0, 0, 0, 1]])
    return camera.checked(where="NerfBaselines' camera"), matrix


def scene_of(dataset: Any, folder: Path) -> Scene:
    """A scene of all views of a loaded dataset, for training; its pictures are written below `folder`.

    Near, far and box come from the pictures' alpha, else from the dataset's points, else from matching the pictures.
    """
    gathering = assemble.Gathering(folder)
    for number, (cameras, picture) in enumerate(zip(dataset["cameras"], dataset["images"], strict=True)):
        camera, matrix = camera_of(cameras)
        path = folder / "images" / f"{number:05d}.png"
        images.write(path, np.asarray(picture))
        mask = None
        if dataset.get("masks") is not None:
            mask = folder / "masks" / f"{number:05d}.png"
            images.write(mask, np.uint8(255) * np.asarray(dataset["masks"][number], bool)[..., None])
        gathering.views.append(View(path.stem, camera, matrix, "train", path, ignored=mask))
    scene = assemble.scene(gathering, tuple(gathering.views), "nerfbaselines")
    points = dataset.get("points3D_xyz")
    if scene.background == "white" or points is None:
        return scene if scene.background == "white" else measured(scene)
    return replace(assemble.with_points(scene, np.asarray(points, np.float64)), colours=dataset.get("points3D_rgb"))
