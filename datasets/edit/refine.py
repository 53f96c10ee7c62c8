"""Bundle adjustment of a scene's own pictures with the arm's poses as priors, through pycolmap.

Features are matched between all pictures and triangulated with the arm's poses. A fifth of the points is held out; the others
refine the poses within the arm's accuracy. The refined poses are used only if the held-out points then fit better. If the
arm's poses explain the pictures already, nothing is changed.
"""

import tempfile
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats.colmap_library import lens_of
from koala3d.datasets.imaging import images
from koala3d.datasets.process.pictures import features
from koala3d.datasets.process.pictures.features import PictureFeatures
from koala3d.datasets.process.pictures.photographs import Photograph
from koala3d.datasets.process.poses import database
from koala3d.datasets.scene import Scene, View

Array, Indices, Mask = NDArray[np.float64], NDArray[np.int64], NDArray[np.bool_]

ENOUGH_PX = 0.5  # median error of held-out points below which the arm's poses explain the pictures: features are no better [px]
MIN_GAIN = 0.02  # share by which the error of held-out points must fall for the refined poses to be used
MIN_POINTS = 50
MIN_SEEN = 40  # a view with fewer points keeps the arm's pose: they would not determine its orientation
LIMIT_PX = 10.0  # a feature further than this from its projected point is a wrong match


@dataclass(frozen=True)
class Prior:
    """Accuracy of the given poses, standard deviations per axis."""

    translation_m: float
    rotation_rad: float


@dataclass(frozen=True)
class Tracks:
    """n observations of points 0..m-1 in views."""

    point: Indices  # (n,) ascending
    view: Indices  # (n,) index in the scene
    pixels: Array  # (n, 2) [px]


@dataclass(frozen=True)
class RefinedScene:
    """Result of bundle adjustment."""

    scene: Scene  # with the poses to use, refined or unchanged
    used: bool
    reason: str
    before_px: float  # median error of the held-out points with the arm's poses [px]
    after_px: float | None  # the same with the refined poses; None if none were computed
    moved_mm: float | None  # rms change of the positions [mm]
    moved_deg: float | None
    points: int

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary, the scene left out."""
        return {k: v for k, v in vars(self).items() if k != "scene"}


def refined(scene: Scene, prior: Prior, *, enough_px: float = ENOUGH_PX, seed: int = 0) -> RefinedScene:
    """Refine the poses of `scene` by its pictures, within the arm's accuracy `prior`.

    Raises DatasetError for views of several cameras, for a splined lens, and for too few points found in the pictures.
    """
    camera, *others = {view.camera for view in scene.views}
    if others:
        why, remedy = f"{1 + len(others)} of them", "refine scenes of one camera"
        raise DatasetError("views have different cameras", where=scene.name, why=why, remedy=remedy)
    if camera.spline is not None:
        why, remedy = "bundle adjustment knows no such lens", "make a copy without distortion: 'datasets edit --undistort'"
        raise DatasetError("camera has a splined lens", where=scene.name, why=why, remedy=remedy)
    with tempfile.TemporaryDirectory() as folder:
        model = _triangulated(scene, camera, Path(folder))
        tracks = _tracks(model)
        points = int(tracks.point.max(initial=-1)) + 1
        if points < MIN_POINTS:
            why = f"{points} points were found in three or more views, {MIN_POINTS} are needed"
            remedy = "put something with texture beside the object"
            raise DatasetError("pictures show too few points to judge the poses", where=scene.name, why=why, remedy=remedy)
        given = np.stack([view.world_from_camera for view in scene.views])
        aside = np.random.default_rng(seed).permutation(points)[: max(points // 5, 10)]
        judged = np.isin(tracks.point, aside)
        before = reprojection(tracks, judged, given, camera)
        if np.median(before) <= enough_px:
            reason = f"the arm's poses already explain the pictures to {np.median(before):.2f} px"
            return RefinedScene(scene, False, reason, float(np.median(before)), None, None, None, points)
        moved = aligned(_adjusted(model, scene, set(aside.tolist()), prior.translation_m), given, prior)
    after = reprojection(tracks, judged, moved, camera)
    better = _score(after) < (1 - MIN_GAIN) * _score(before)
    verdict = "fit better" if better else "do not fit better"
    reason = f"held-out points {verdict}: {np.median(before):.2f} px before, {np.median(after):.2f} px after"
    if better:
        scene = scene.with_views(tuple(replace(v, world_from_camera=m) for v, m in zip(scene.views, moved, strict=True)))
    medians = float(np.median(before)), float(np.median(after))
    return RefinedScene(scene, better, reason, *medians, *pose.rms_difference(given, moved), points)


def _score(errors: Array) -> float:
    """Mean error with each error limited to `LIMIT_PX` [px]."""
    return float(np.mean(np.minimum(errors, LIMIT_PX)))


def _triangulated(scene: Scene, camera: Camera, folder: Path) -> Any:
    """pycolmap's model with points triangulated from the scene's poses; image number i + 1 is view i."""
    import pycolmap

    pictures = [
        database.Picture(number, f"{number - 1:05d}.png", _photograph(view), 1, _features(view))
        for number, view in enumerate(scene.views, 1)
    ]
    kind, numbers = lens_of(camera)
    stored = folder / "features.db"
    database.write(stored, pictures, (kind, numbers, True))
    database.match(stored, pictures, list(combinations(range(len(pictures)), 2)))
    model = pycolmap.Reconstruction()
    theirs = pycolmap.Camera(camera_id=1, model=kind, width=camera.width, height=camera.height, params=numbers)
    model.add_camera_with_trivial_rig(theirs)
    for picture, view in zip(pictures, scene.views, strict=True):
        image = pycolmap.Image(picture.file, picture.features.pixels.astype(np.float64), 1, picture.number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose.inverse(view.world_from_camera)[:3]))
    settings = pycolmap.IncrementalPipelineOptions()
    settings.mapper.filter_max_reproj_error = settings.triangulation.complete_max_reproj_error = LIMIT_PX
    settings.triangulation.merge_max_reproj_error = LIMIT_PX
    settings.triangulation.create_max_angle_error = settings.triangulation.continue_max_angle_error = 4.0
    return pycolmap.triangulate_points(model, stored, folder, folder, options=settings)


def _photograph(view: View) -> Photograph:
    return Photograph(view.name, view.image, view.camera.width, view.camera.height)


def _features(view: View) -> PictureFeatures:
    """Of the object alone if there is an alpha or a mask."""
    picture = view.read()
    mask = np.where(picture[..., 3] > 0.5, 255, 0).astype(np.uint8) if picture.shape[-1] == 4 else None
    return features.detect_in(images.to_uint8(picture[..., :3]), mask)


def _index(name: str) -> int:
    return int(Path(name).stem)


def _tracks(model: Any) -> Tracks:
    """Observations of points seen by three views and more, in the order of the points' numbers."""
    rows, number = [], 0
    for _, point in sorted(model.points3D.items()):
        if point.track.length() < 3:
            continue
        for element in point.track.elements:
            image = model.images[element.image_id]
            rows.append((number, _index(image.name), *image.points2D[element.point2D_idx].xy))
        number += 1
    table = np.array(rows, np.float64).reshape(-1, 4)
    return Tracks(table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2:])


def reprojection(tracks: Tracks, chosen: Mask, world_from_camera: Array, camera: Camera) -> Array:
    """(k,) distances [px] between the `chosen` (n,) observations and their points, triangulated with given (views, 4, 4) poses.

    A point is where its rays come closest, then where the squared distances in the pictures are least (Gauss-Newton).
    """
    _, point = np.unique(tracks.point[chosen], return_inverse=True)
    camera_from_world = pose.inverse(world_from_camera)[tracks.view[chosen]]
    rotation, translation = camera_from_world[:, :3, :3], camera_from_world[:, :3, 3]
    rays = np.einsum("nji,nj->ni", rotation, camera.directions(tracks.pixels[chosen]))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    across = np.eye(3) - rays[:, :, None] * rays[:, None]
    centres = -np.einsum("nji,nj->ni", rotation, translation)
    places = _solved(point, across, np.einsum("nij,nj->ni", across, centres))
    for _ in range(4):
        in_camera = np.einsum("nij,nj->ni", rotation, places[point]) + translation
        depth = np.maximum(in_camera[:, 2:], 1e-6)
        jacobian = np.zeros((len(point), 2, 3))
        jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1
        jacobian[:, :, 2] = -in_camera[:, :2] / depth
        jacobian = (jacobian / depth[..., None]) @ rotation * np.array([[camera.fx], [camera.fy]])
        off = tracks.pixels[chosen] - camera.project(np.concatenate([in_camera[:, :2], depth], -1))
        places = places + _solved(point, np.swapaxes(jacobian, 1, 2) @ jacobian, np.einsum("nji,nj->ni", jacobian, off))
    in_camera = np.einsum("nij,nj->ni", rotation, places[point]) + translation
    in_camera[:, 2] = np.maximum(in_camera[:, 2], 1e-6)
    return np.linalg.norm(tracks.pixels[chosen] - camera.project(in_camera), axis=1)


def _solved(point: Indices, matrices: Array, sides: Array) -> Array:
    """(m, 3) solutions of the normal equations that each point's (n, 3, 3) and (n, 3) observations add up to."""
    count = int(point.max()) + 1
    total, side = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(total, point, matrices)
    np.add.at(side, point, sides)
    total += 1e-12 * np.trace(total, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    return np.linalg.solve(total, side[..., None])[..., 0]


def _adjusted(model: Any, scene: Scene, aside: set[int], prior_m: float) -> Array:
    """(views, 4, 4) poses after bundle adjustment without the points `aside`; `prior_m`: of camera centres, per axis [m]."""
    import pycolmap

    number = 0
    for key, point in sorted(model.points3D.items()):
        long = point.track.length() >= 3
        if not long or number in aside:
            model.delete_point3D(key)
        number += long
    config, priors, cartesian = pycolmap.BundleAdjustmentConfig(), [], pycolmap.PosePriorCoordinateSystem.CARTESIAN
    for image_id, image in model.images.items():
        config.add_image(image_id)
        if image.num_points3D < MIN_SEEN:
            config.set_constant_rig_from_world_pose(image.frame_id)
        centre = scene.views[_index(image.name)].world_from_camera[:3, 3]
        known = {"position": centre, "position_covariance": prior_m**2 * np.eye(3), "coordinate_system": cartesian}
        priors.append(pycolmap.PosePrior(corr_data_id=image.data_id, **known))
    names = ("refine_focal_length", "refine_principal_point", "refine_extra_params", "print_summary")
    options = pycolmap.BundleAdjustmentOptions(**dict.fromkeys(names, False))
    options.ceres.loss_function_type, options.ceres.loss_function_scale = pycolmap.LossFunctionType.SOFT_L1, 1.0
    options.ceres.solver_options.num_threads = 1
    of_priors = pycolmap.PosePriorBundleAdjustmentOptions()
    pycolmap.create_pose_prior_bundle_adjuster(options, of_priors, config, priors, model).solve()
    moved = np.stack([view.world_from_camera for view in scene.views])
    for image in model.images.values():
        matrix = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
        moved[_index(image.name)] = pose.inverse(pose.checked(matrix, where="bundle adjustment"))
    return moved


def aligned(moved: Array, given: Array, prior: Prior) -> Array:
    """(views, 4, 4) `moved` poses, all of them together moved rigidly to best match the poses of the arm.

    Pictures do not determine the orientation of the whole scene, and for a short arc of views priors on camera centres hardly
    do. The arm's orientations are used as well: least squares over one rigid motion, in units of the arm's accuracy
    (Gauss-Newton).
    """
    for _ in range(10):
        off = given[:, :3, 3] - moved[:, :3, 3]
        turn = pose.rotation_vector(given[:, :3, :3] @ np.swapaxes(moved[:, :3, :3], 1, 2))
        by_motion = (
            np.concatenate([np.tile(np.eye(3), (len(moved), 1, 1)), -pose.cross(moved[:, :3, 3])], -1) / prior.translation_m
        )
        by_turn = np.concatenate([np.zeros((len(moved), 3, 3)), np.tile(np.eye(3), (len(moved), 1, 1))], -1) / prior.rotation_rad
        rows = np.concatenate([by_motion, by_turn]).reshape(-1, 6)
        sides = np.concatenate([off / prior.translation_m, turn / prior.rotation_rad]).ravel()
        step = np.linalg.lstsq(rows, sides, rcond=None)[0]
        moved = pose.from_rotation_vector(step[3:], step[:3]) @ moved
    return moved
