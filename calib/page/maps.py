"""How certain a calibration is over the image, from the covariance that its file keeps."""

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.calib.intrinsics import projection
from koala3d.calib.intrinsics.over_image import Map, cells
from koala3d.calib.solver.geometry import by_motion
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.core.errors import UsageError

AXES = [f"{kind} {axis}" for kind in ("translation", "rotation") for axis in "xyz"]
COLUMNS = 48  # square cells along the image's width


def projection_uncertainty(calibration: Calibration, distance_m: float) -> Map:
    """Standard deviation of where a point is seen, in the direction in which it is largest.

    With a hand-eye pose, the point stands still in the frame of the flange (of the base, where the camera stands beside the arm)
    at `distance_m` [m] from the camera. Of a camera alone only directions are known, and a rotation of the camera looks like
    another principal point: the rotation that brings the images of all points closest is then left out, and the distance does
    not matter.

    Raises:
        UsageError: nothing was estimated, or the file keeps no correlations.
    """
    camera = calibration.camera
    down = max(round(COLUMNS * camera.height / camera.width), 1)
    columns, rows, pixels = cells(camera, COLUMNS, down)
    directions = camera.directions(pixels)
    points = distance_m * directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    _, by_point, by_intrinsics = projection.project(points, projection.vector(camera), projection.form(camera))
    mount = calibration.flange_from_camera or calibration.base_from_camera
    names, covariance = _covariance(calibration, mount)
    free = [name for name in names if name in projection.NAMES or projection.is_knot(name)]
    of_camera = by_intrinsics[..., projection.columns(free)]
    if mount is None:
        rotation = by_motion(by_point, points)[..., 3:].reshape(-1, 3)
        flat = of_camera.reshape(-1, len(free))
        moved = (flat - rotation @ np.linalg.lstsq(rotation, flat, rcond=None)[0]).reshape(of_camera.shape)
    else:
        in_mount = points @ mount.matrix[:3, :3].T + mount.matrix[:3, 3]
        moved = np.concatenate([of_camera, -by_motion(by_point @ mount.matrix[:3, :3].T, in_mount)], -1)
    spread = moved @ covariance @ np.swapaxes(moved, 1, 2)
    worst = np.sqrt(np.maximum(np.linalg.eigvalsh(spread)[:, -1], 0.0))
    return Map(columns, rows, worst.reshape(len(rows), len(columns)))


def _covariance(calibration: Calibration, mount: UncertainPose | None) -> tuple[list[str], Array]:
    """Names of the estimated intrinsics and, with a hand-eye pose, of its six errors; and their covariance."""
    kept = calibration.residuals.camera_correlation if mount is None else calibration.residuals.rig_correlation
    if not calibration.camera_std and mount is None:
        raise UsageError("calibration keeps no uncertainty", why="its camera was given", remedy="estimate it from a recording")
    if kept is None:
        remedy = "make it again with 'calib handeye' or 'calib intrinsics'"
        raise UsageError("calibration does not keep how its errors are correlated", remedy=remedy)
    stds = dict(calibration.camera_std)
    if mount is not None:
        title = next(name for name, value in calibration.poses.items() if value is mount)
        deviations = map(float, np.sqrt(np.diag(mount.covariance)))
        stds |= dict(zip((f"{title} {axis}" for axis in AXES), deviations, strict=True))
    names = [name for name in kept.names if name in stds]
    std = np.array([stds[name] for name in names])
    values, vectors = np.linalg.eigh(kept.among(tuple(names)))
    among = (vectors * np.maximum(values, 0.0)) @ vectors.T  # rounded in the file: kept from becoming negative
    return names, np.asarray(among * np.outer(std, std), np.float64)
