"""What moves or scales a whole reconstruction: errors of the calibration, propagated to the surface.

All views share the errors of the hand-eye pose and of the intrinsics. A point that is reconstructed from views all around appears
where its wrong rays meet best. The object as a whole is moved, turned and scaled by the similarity that explains most of the
shift of its pixels; what it does not explain is an error of single places and shows in the model's own agreement.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.scene import Scene, View

POINTS, VIEWS = 300, 40
"""Points of the surface and views that are enough to determine seven numbers."""
INTRINSICS = ("fx", "fy", "cx", "cy")
NUDGE = 1e-6
"""Size of a difference [m, rad], and [px] after division by it."""


@dataclass(frozen=True)
class Common:
    """Covariance of the similarity that the calibration's errors move an object by."""

    covariance: Float[np.ndarray, "7 7"]
    """Of a shift [m], a rotation vector [rad] and the logarithm of a scale, about `centre`."""
    centre: Float[np.ndarray, " 3"]

    @property
    def scale_std(self) -> float:
        """Relative standard deviation of the object's size."""
        return float(np.sqrt(self.covariance[6, 6]))

    @property
    def place_std(self) -> float:
        """Standard deviation of its place per axis [m]."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3]) / 3))

    def along(self, points: Float[np.ndarray, "v 3"], normals: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, " v"]:
        """Standard deviation of points along their unit normals [m]."""
        arm = points - self.centre
        columns = np.concatenate([normals, np.cross(arm, normals), np.sum(arm * normals, -1, keepdims=True)], -1)
        return np.sqrt(np.maximum(np.einsum("vi,ij,vj->v", columns, self.covariance, columns), 0))


def of(scene: Scene, points: Float[np.ndarray, "v 3"]) -> Common | None:
    """What the calibration of a scene leaves open of an object with these points [m]; None where the scene states none."""
    stated = scene.provenance.get("flange_from_camera")
    if not (scene.metric and stated):
        return None
    try:
        mount = UncertainPose.from_json(stated, where=scene.name)
    except KoalaError:
        return None
    camera_std = _camera_std(scene.provenance)
    views = scene.views[:: max(1, len(scene.views) // VIEWS)][:VIEWS]
    some = points[np.linspace(0, len(points) - 1, min(POINTS, len(points))).astype(int)]
    centre = some.mean(0)
    intrinsics = [name for name in INTRINSICS if camera_std.get(name, 0.0) > 0]
    left, right = zip(*(_equations(view, some, centre, mount, intrinsics) for view in views), strict=True)
    moved = np.linalg.lstsq(np.concatenate(left), -np.concatenate(right), rcond=None)[0]  # (7, 6 + intrinsics)
    known = np.zeros((6 + len(intrinsics),) * 2)
    known[:6, :6] = mount.covariance
    known[6:, 6:] = np.diag([camera_std[name] ** 2 for name in intrinsics])
    return Common(moved @ known @ moved.T, centre)


def _camera_std(provenance: dict[str, Any]) -> dict[str, float]:
    """Standard deviations of the intrinsics, from the calibration's file if it is still the one that the scene was built with."""
    path = Path(str(provenance.get("calibration", "")))
    try:
        if path.is_file() and files.sha256(path) == provenance.get("calibration_sha256"):
            return Calibration.load(path).camera_std
    except (KoalaError, OSError):
        pass
    return {}


def _equations(
    view: View, points: Float[np.ndarray, "n 3"], centre: Float[np.ndarray, " 3"], mount: UncertainPose, intrinsics: list[str]
) -> tuple[Float[np.ndarray, "m 7"], Float[np.ndarray, "m k"]]:
    """How the pixels of points move with the object's similarity, and with each error of the calibration."""

    def seen(at: np.ndarray, camera: Any = view.camera, world_from_camera: np.ndarray = view.world_from_camera) -> np.ndarray:
        return camera.project((at - world_from_camera[:3, 3]) @ world_from_camera[:3, :3]).reshape(-1)

    before, arm = seen(points), points - centre
    moves = [np.broadcast_to(axis, points.shape) for axis in np.eye(3)] + [np.cross(axis, arm) for axis in np.eye(3)] + [arm]
    by_object = [(seen(points + NUDGE * move) - before) / NUDGE for move in moves]
    by_error = []
    for twist in np.eye(6):  # a left perturbation, translation first
        nudged = pose.rigid(np.eye(3) + NUDGE * pose.cross(twist[3:]), NUDGE * twist[:3])
        world_from_camera = view.world_from_camera @ pose.inverse(mount.matrix) @ nudged @ mount.matrix
        by_error.append((seen(points, world_from_camera=world_from_camera) - before) / NUDGE)
    for name in intrinsics:
        camera = replace(view.camera, **{name: getattr(view.camera, name) + NUDGE})
        by_error.append((seen(points, camera=camera) - before) / NUDGE)
    return np.stack(by_object, -1), np.stack(by_error, -1)
