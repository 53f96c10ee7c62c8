"""Checks of cameras, poses and splits that need no images."""

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.core.findings import Finding
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.structure import bounds

LEAK_DEG, LEAK_SHARE = 0.5, 0.005
"""A test camera closer than this to a training camera, in angle and relative to its distance to the focus, repeats its image."""
OFF_CENTRE, NOT_SQUARE = 0.2, 0.05
"""Limits beyond which intrinsics look wrong: offset of the principal point as a share of the width, and |fx / fy - 1|."""
METRES = (0.01, 100.0)
"""Plausible distances between cameras and their focus in a metric scene [m]."""


def check_poses(scene: Scene) -> list[Finding]:
    """Findings on splits, names, poses, intrinsics, scale and leakage."""
    return [*_splits(scene), *_places(scene), *_intrinsics(scene), *_scale(scene), *_leakage(scene)]


def _splits(scene: Scene) -> list[Finding]:
    present = {view.split for view in scene.views}
    names = [view.name for view in scene.views]
    remedy = "set the split of some views: datasets edit SCENE --hold-out 8"
    found = [
        Finding(level, f"there are no {split} views", scene.name, remedy=remedy)
        for level, split in (("error", "train"), ("warning", "test"))
        if split not in present
    ]
    twice = sorted({name for name in names if names.count(name) > 1})
    return found + [
        Finding("error", "name is used twice", f"view {name}", remedy="give each view its own name") for name in twice
    ]


def _places(scene: Scene) -> list[Finding]:
    """Cameras that stand on one spot, look away from the box, or are far from all others."""
    positions = np.stack([view.world_from_camera[:3, 3] for view in scene.views])
    found = []
    if len(scene.views) > 1 and np.ptp(positions, axis=0).max() < 1e-9:
        found.append(Finding("error", "all cameras stand on one spot", scene.name, remedy="check the translations of the poses"))
    distances = np.linalg.norm(positions - np.median(positions, axis=0), axis=1)
    limit = 20 * max(float(np.median(distances)), 1e-12)
    for view, distance in zip(scene.views, distances, strict=True):
        where = f"view {view.name}"
        if distance > limit:
            why = f"{distance:.3g} from the middle of all cameras, half of them are within {np.median(distances):.3g}"
            found.append(Finding("warning", "camera is far from all others", where, why, "check its pose and unit"))
        if not _sees(view, scene.box):
            why, remedy = f"box {scene.box.round(3).tolist()}", "check its pose, its axis convention and the box"
            found.append(Finding("warning", "camera looks away from the object's box", where, why, remedy))
    return found


def _sees(view: View, box: NDArray[np.float64]) -> bool:
    """True where at least one point of a grid in the box is in front of the camera and inside its image."""
    steps = np.linspace(0, 1, 5)
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    return bool(np.isfinite(bounds.depths_in_picture(view, box[0] + grid * (box[1] - box[0]))).any())


def _intrinsics(scene: Scene) -> list[Finding]:
    """Principal points far from the middle and pixels far from square, once per camera."""
    found = []
    first = {view.camera: view for view in reversed(scene.views)}
    for camera, view in first.items():
        where = f"camera of view {view.name}"
        offset = max(abs(camera.cx / camera.width - 0.5), abs(camera.cy / camera.height - 0.5))
        if offset > OFF_CENTRE:
            why = f"({camera.cx:.1f}, {camera.cy:.1f}) in an image of {camera.width}x{camera.height}"
            remedy = "intrinsics may be for images of another size or cut"
            found.append(Finding("warning", "principal point is far from the middle", where, why, remedy))
        if abs(camera.fx / camera.fy - 1) > NOT_SQUARE:
            why = f"fx {camera.fx:.1f}, fy {camera.fy:.1f}"
            found.append(Finding("warning", "pixels are not square", where, why, "width and height may be swapped"))
    return found


def _scale(scene: Scene) -> list[Finding]:
    """Metric scenes at an implausible scale, and near and far that exclude what the cameras look at."""
    matrices = np.stack([view.world_from_camera for view in scene.views])
    centre, spread = bounds.focus(matrices)
    if spread < bounds.PARALLEL:
        return []
    distance = float(np.median(np.linalg.norm(matrices[:, :3, 3] - centre, axis=1)))
    found = []
    if scene.metric and not METRES[0] < distance < METRES[1]:
        why = f"cameras are {distance:.3g} m from where they look"
        remedy = "poses may be in millimetres: multiply their translations"
        found.append(Finding("warning", "scale is implausible", scene.name, why, remedy))
    if scene.near > 2 * distance or scene.far < 0.5 * distance:
        far = "infinity" if np.isinf(scene.far) else f"{scene.far:.3g}"
        why = f"near {scene.near:.3g}, far {far}, cameras look {distance:.3g} away"
        found.append(Finding("warning", "near and far leave out where the cameras look", scene.name, why, "check their unit"))
    return found


def _leakage(scene: Scene) -> list[Finding]:
    """Test views taken from the pose of a training view: they measure memory, not reconstruction."""
    train = [view for view in scene.views if view.split == "train"]
    test = [view for view in scene.views if view.split == "test"]
    if not train or not test:
        return []
    matrices = np.stack([view.world_from_camera for view in train])
    centre = bounds.focus(np.stack([view.world_from_camera for view in scene.views]))[0]
    found = []
    for view in test:
        shift, turn = pose.difference(matrices, view.world_from_camera[None])
        reach = max(float(np.linalg.norm(view.world_from_camera[:3, 3] - centre)), 1e-12)
        close = np.flatnonzero((shift < LEAK_SHARE * reach) & (turn < np.deg2rad(LEAK_DEG)))
        if len(close):
            nearest = close[np.argmin(shift[close])]
            why = f"view {train[nearest].name} is {100 * shift[nearest] / reach:.2g}% of the distance and "
            why += f"{np.rad2deg(turn[nearest]):.2g} degrees away"
            what, remedy = (
                "test view was taken where a training view was",
                "remove one of the two, else test figures are too good",
            )
            found.append(Finding("warning", what, f"view {view.name}", why, remedy))
    return found
