"""Ways to injure a good scene, each at three strengths: what the checks must name.

Every injury takes a scene, a strength and a folder for changed pictures, and returns the injured scene and the names of the views
that it hurt. Pixels are those of the scene's pictures.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.checks import masks
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.structure import bounds

Hurt = tuple[Scene, set[str]]
Picture = NDArray[np.float32]
EVERY = 8
"""One view in so many is hurt where views are hurt one by one."""


@dataclass(frozen=True)
class Injury:
    """One way to injure a scene."""

    name: str
    cause: str
    """Of the finding that names it."""
    strengths: tuple[float, float, float]
    unit: str
    apply: Callable[[Scene, float, Path], Hurt]
    needs: str = ""
    """"masks", "whole masks" (at least a third end inside their pictures), "surroundings" or "all around"; empty for any."""


def chosen(scene: Scene, among: list[int] | None = None) -> list[int]:
    """Indices of the views that are hurt, one in `EVERY` of all or of those given, at least two, in no regular order."""
    among = list(range(len(scene.views))) if among is None else among
    count = max(2, len(among) // EVERY)
    return sorted(np.random.default_rng(5).choice(among, count, replace=False).tolist())


def whole(scene: Scene) -> list[int]:
    """Indices of the views with a mask that does not reach the picture's edge: the others are not judged."""
    pictures = [view.read() for view in scene.views]
    return [index for index, picture in enumerate(pictures) if picture.shape[-1] == 4 and not masks.cut(picture[..., 3] > 0.5)]


def _replaced(scene: Scene, changed: dict[int, View]) -> Hurt:
    views = tuple(changed.get(index, view) for index, view in enumerate(scene.views))
    return scene.with_views(views), {view.name for view in changed.values()}


def _repainted(scene: Scene, folder: Path, indices: list[int], paint: Callable[[Picture, int], Picture]) -> Hurt:
    changed = {}
    for index in indices:
        view = scene.views[index]
        path = folder / f"{view.name.replace('/', '_')}.png"
        images.write(path, paint(view.read(), index).clip(0, 1))
        changed[index] = replace(view, image=path, mask=None, deviation=None)
    return _replaced(scene, changed)


def moved_poses(scene: Scene, strength: float, folder: Path) -> Hurt:
    """Single cameras turned or moved so that their pictures shift by `strength` pixels."""
    random, changed = np.random.default_rng(1), {}
    focus = bounds.focus(np.stack([view.world_from_camera for view in scene.views]))[0]
    for number, index in enumerate(chosen(scene)):
        view, angle = scene.views[index], random.uniform(0, 2 * np.pi)
        across = np.array([np.cos(angle), np.sin(angle), 0.0]) * strength / view.camera.fx
        distance = float(np.linalg.norm(view.world_from_camera[:3, 3] - focus))
        change = pose.from_rotation_vector(across) if number % 2 else pose.from_rotation_vector((0, 0, 0), across * distance)
        changed[index] = replace(view, world_from_camera=view.world_from_camera @ change)
    return _replaced(scene, changed)


def wrong_focal(scene: Scene, strength: float, folder: Path) -> Hurt:
    """Focal lengths `strength` percent too long."""
    factor = 1 + strength / 100
    cameras = [replace(view.camera, fx=view.camera.fx * factor, fy=view.camera.fy * factor) for view in scene.views]
    views = tuple(replace(view, camera=camera) for view, camera in zip(scene.views, cameras, strict=True))
    return scene.with_views(views), set()


def wrong_distortion(scene: Scene, strength: float, folder: Path) -> Hurt:
    """A radial distortion that nothing shows: `strength` pixels at the middle of the picture's edge, or of masked objects'."""
    views, share = [], shown(scene)
    for view in scene.views:
        half = share * bounds.half_field(view.camera)
        k1 = view.camera.k1 - strength / view.camera.fx / half**3
        views.append(replace(view, camera=replace(view.camera, k1=k1)))
    return scene.with_views(tuple(views)), set()


def shown(scene: Scene) -> float:
    """Share of a picture's half width or height within which nearly all of the object lies; 1 without masks."""
    if scene.background != "white":
        return 1.0
    ends = []
    for view in scene.views[:: max(1, len(scene.views) // 12)]:
        picture, half = view.read(), max(view.camera.width, view.camera.height) / 2
        if picture.shape[-1] == 4 and (picture[..., 3] > 0.5).any():
            row, column = np.nonzero(picture[..., 3] > 0.5)
            ends.append(np.quantile(np.hypot(row + 0.5 - view.camera.cy, column + 0.5 - view.camera.cx), 0.98) / half)
    return min(1.0, float(np.median(ends))) if ends else 1.0


def wrong_exposure(scene: Scene, strength: float, folder: Path) -> Hurt:
    """Single pictures with `strength` times the light."""
    return _repainted(scene, folder, chosen(scene), lambda picture, _: lit(picture, (strength,) * 3))


def wrong_white(scene: Scene, strength: float, folder: Path) -> Hurt:
    """Single pictures with `strength` times the blue light and as much less red."""
    return _repainted(scene, folder, chosen(scene), lambda picture, _: lit(picture, (1 / strength, 1.0, strength)))


def lit(picture: Picture, gains: tuple[float, ...]) -> Picture:
    """A picture with other gains in linear light."""
    colour = images.srgb_from_linear(images.linear_from_srgb(picture[..., :3]) * np.array(gains, np.float32))
    return np.concatenate([colour, picture[..., 3:]], axis=-1)


def blurred(scene: Scene, strength: float, folder: Path) -> Hurt:
    """Single pictures out of focus: Gaussian blur with a standard deviation of `strength` pixels."""

    def paint(picture: Picture, _: int) -> Picture:
        if picture.shape[-1] == 3:
            return np.asarray(cv2.GaussianBlur(picture, (0, 0), strength), np.float32)
        share = cv2.GaussianBlur(picture[..., 3], (0, 0), strength)[..., None]
        colour = cv2.GaussianBlur(picture[..., :3] * picture[..., 3:], (0, 0), strength) / np.maximum(share, 1e-3)
        return np.asarray(np.concatenate([colour, picture[..., 3:]], axis=-1), np.float32)

    return _repainted(scene, folder, chosen(scene), paint)


def shifted_masks(scene: Scene, strength: float, folder: Path) -> Hurt:
    """Masks of single views shifted by `strength` pixels."""
    move = np.array([[1, 0, 0.8 * strength], [0, 1, 0.6 * strength]], np.float32)
    return _remasked(scene, folder, lambda mask: np.asarray(cv2.warpAffine(mask, move, mask.shape[::-1]), np.float32))


def eroded_masks(scene: Scene, strength: float, folder: Path) -> Hurt:
    """Masks of single views too small by `strength` pixels on each side."""
    size = 2 * round(strength) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return _remasked(scene, folder, lambda mask: np.asarray(cv2.erode(mask, kernel), np.float32))


def _remasked(scene: Scene, folder: Path, change: Callable[[Picture], Picture]) -> Hurt:
    def paint(picture: Picture, _: int) -> Picture:
        return np.concatenate([picture[..., :3], change(np.ascontiguousarray(picture[..., 3]))[..., None]], axis=-1)

    return _repainted(scene, folder, chosen(scene, whole(scene)), paint)


def moving_thing(scene: Scene, strength: float, folder: Path) -> Hurt:
    """A patterned disc of `strength` percent of the picture's width that wanders from picture to picture."""
    random = np.random.default_rng(2)
    noise = np.sum([cv2.GaussianBlur(random.random((512, 512, 3)), (0, 0), s) * s for s in (1.5, 4.0, 9.0)], axis=0)
    noise = np.clip(0.5 + (noise - noise.mean()) / (4 * noise.std()), 0, 1).astype(np.float32)

    def paint(picture: Picture, index: int) -> Picture:
        height, width = picture.shape[:2]
        across = max(int(strength / 100 * width), 4)
        pattern = cv2.resize(noise[:across, :across] if across < 512 else noise, (across, across))
        phase = 0.9 * index
        left = int((0.5 + 0.3 * np.sin(phase)) * width - across / 2)
        top = int((0.5 + 0.3 * np.cos(0.7 * phase)) * height - across / 2)
        rows, columns = np.mgrid[:across, :across]
        disc = np.hypot(rows - across / 2, columns - across / 2) < across / 2
        result, y, x = picture.copy(), rows + top, columns + left
        disc &= (y >= 0) & (y < height) & (x >= 0) & (x < width)
        result[y[disc], x[disc], :3] = pattern[disc]
        return result

    return _repainted(scene, folder, list(range(len(scene.views))), paint)[0], set()


def gap(scene: Scene, strength: float, folder: Path) -> Hurt:
    """No training view within `strength` degrees of one view."""
    matrices = np.stack([view.world_from_camera for view in scene.views])
    outward = matrices[:, :3, 3] - bounds.focus(matrices)[0]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    alone = len(scene.views) // 3
    far = outward @ outward[alone] < np.cos(np.deg2rad(strength))
    far[alone] = True
    return scene.with_views(tuple(view for view, kept in zip(scene.views, far, strict=True) if kept)), {scene.views[alone].name}


def wrong_box(scene: Scene, strength: float, folder: Path) -> Hurt:
    """The box moved along its longest side by `strength` percent of its length."""
    size = scene.box[1] - scene.box[0]
    shift = np.zeros(3)
    shift[int(np.argmax(size))] = strength / 100 * size.max()
    return replace(scene, box=scene.box + shift, bounds_from="stated"), set()


INJURIES = (
    Injury("pose", "pose", (1, 3, 10), "px", moved_poses),
    Injury("focal length", "intrinsics", (1, 3, 10), "%", wrong_focal),
    Injury("distortion", "intrinsics", (2, 5, 12), "px", wrong_distortion),
    Injury("exposure", "exposure", (0.8, 0.6, 0.4), "x", wrong_exposure),
    Injury("white balance", "white balance", (1.15, 1.3, 1.6), "x", wrong_white),
    Injury("blur", "blur", (1.5, 3, 6), "px", blurred),
    Injury("mask shifted", "mask", (3, 8, 20), "px", shifted_masks, "whole masks"),
    Injury("mask eroded", "mask", (3, 8, 20), "px", eroded_masks, "whole masks"),
    Injury("moving thing", "motion", (12, 20, 35), "%", moving_thing, "surroundings"),
    Injury("gap", "coverage", (35, 50, 65), "deg", gap, "all around"),
    Injury("box", "box", (40, 70, 120), "%", wrong_box, "masks"),
)
"""Every injury, from the smallest strength to the largest."""
