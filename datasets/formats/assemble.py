"""What the readers of foreign layouts share: missing files, hold-out, background and bounds."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.camera_model import Camera
from datasets.core import files
from datasets.core.errors import DatasetError, KoalaError
from datasets.imaging import images
from datasets.scene import Scene, View
from datasets.structure import bounds
from datasets.structure.hull import visual_hull

SAME_SHAPE = 0.02
"""Aspect ratios that differ by less are those of one image at two sizes, each rounded to pixels."""
SHORTEST, LONGEST = 1e-3, 1e6
"""Focal lengths per width of the image between which there are cameras: views of 180 degrees, and of a ten-thousandth."""
CAMERAS_ALONE = "cameras alone"
"""`Scene.bounds_from` where nothing but where the cameras stand and look is known."""


@dataclass
class Gathering:
    """Views as they are read one by one, and what went wrong on the way."""

    folder: Path
    problems: list[KoalaError] | None = None
    """Where errors go; None raises them."""
    views: list[View] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    rescaled: list[str] = field(default_factory=list)
    """For each view whose image has another size than its camera, both sizes."""

    def complain(self, error: KoalaError) -> None:
        """Keep an error for later, or raise it."""
        if self.problems is None:
            raise error
        self.problems.append(error)

    def file(self, path: Path, *, where: object) -> Path:
        """`path`, which begins with the folder; raises DatasetError where it leaves it, also through a symbolic link."""
        return files.within(self.folder, path, where=where)

    def fitted(self, camera: Camera, picture: Path, *, where: object) -> Camera:
        """`fitted` of this module, keeping in mind pictures of another size than their camera."""
        found = fitted(camera, picture, where=where)
        if (found.width, found.height) != (camera.width, camera.height):
            self.rescaled.append(f"{camera.width}x{camera.height} for an image of {found.width}x{found.height}")
        return found

    def finished(self, *, listed_in: str) -> tuple[View, ...]:
        """The views, once there are any, with a note that names the missing images.

        Raises:
            DatasetError: no view is left, or two have one name.
        """
        if self.missing:
            total = len(self.missing) + len(self.views)
            self.notes.append(
                f"{len(self.missing)} of {total} images listed in {listed_in} are missing and left out: {', '.join(self.missing)}"
            )
        if self.rescaled:
            several = " and others" if len(set(self.rescaled)) > 1 else ""
            self.notes.append(
                f"intrinsics of {len(self.rescaled)} of {len(self.views)} views are scaled to their images: "
                f"the file says {self.rescaled[0]}{several}"
            )
        if not self.views:
            why = f"{listed_in} lists {len(self.missing)}, none of which exists" if self.missing else f"{listed_in} lists none"
            raise DatasetError("scene has no images", where=self.folder, why=why, remedy="put the images where it says")
        without = [view.name for view in self.views if view.mask is None]
        if 0 < len(without) < len(self.views):
            self.complain(
                DatasetError(
                    "only some views have a mask",
                    where=self.folder,
                    remedy="give all of them one, or none",
                    why=f"{len(without)} of {len(self.views)} have none: {', '.join(without[:5])}",
                )
            )
            self.views = [replace(view, mask=None) for view in self.views]
        names = [view.name for view in self.views]
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            self.complain(DatasetError("view is listed twice", where=f"{self.folder / listed_in}, {twice}"))
        return tuple(self.views)


def fitted(camera: Camera, picture: Path, *, where: object) -> Camera:
    """The camera at the size of its picture, which must have its shape: files often speak of larger images.

    Raises:
        DatasetError: the picture has another shape, or is none.
    """
    width, height = images.size(picture)
    camera = camera.checked(where=where)
    if (width, height) == (camera.width, camera.height):
        return camera
    if abs(width * camera.height / (height * camera.width) - 1) > SAME_SHAPE:
        raise DatasetError(
            "image has another shape than its camera",
            where=where,
            remedy="use the images that it was made for",
            why=f"it is {width}x{height}, the file says {camera.width}x{camera.height}",
        )
    return camera.scaled(width, height)


def hold_out(views: Iterable[View], every: int) -> tuple[View, ...]:
    """The views with each `every`-th by sorted name, from the first on, as "test" and the rest as "train"."""
    views = tuple(views)
    test = {view.name for view in sorted(views, key=lambda view: view.name)[::every]} if every > 0 else set()
    return tuple(replace(view, split="test" if view.name in test else "train") for view in views)


def scene(
    gathering: Gathering, views: tuple[View, ...], *, near_far: tuple[float, float] | None = None, provenance: dict[str, Any]
) -> Scene:
    """Scene of a layout that says nothing of background and box: both are found from images and cameras.

    Views with an alpha or a mask show an object before nothing ("white"): its box is the visual hull's. Otherwise the
    surroundings are seen ("scene"), and the box is where the cameras look.
    """
    for view in views:
        focal = np.array([view.camera.fx, view.camera.fy]) / view.camera.width
        if not ((focal > SHORTEST) & (focal < LONGEST)).all():
            raise DatasetError(
                "focal length is out of all range",
                where=f"{gathering.folder}, view {view.name}",
                why=f"fx {view.camera.fx:.3g}, fy {view.camera.fy:.3g} at a width of {view.camera.width}",
            )
    masked = _has_nothing(views)
    train = tuple(view for view in views if view.split == "train") or views
    if masked:
        hull = visual_hull(train, bounds.visible_box(train))
        box, (near, far) = hull.box, hull.depth_range(views)
        if near_far is not None and max(near, near_far[0]) < min(far, near_far[1]):  # else the file's are of something else
            near, far = max(near, near_far[0]), min(far, near_far[1])
        evidence = f"masks or alpha of {hull.views_used} views" if hull.views_used else CAMERAS_ALONE
    else:
        box, near, far = bounds.surroundings(train)
        evidence = CAMERAS_ALONE
        if near_far is not None:
            near, far = near_far
            evidence += "; near and far as stated"
            if bounds.focus(np.stack([view.world_from_camera for view in train]))[1] < bounds.PARALLEL:
                box = bounds.frustum_box(train, near, far)
    if not (np.isfinite(box).all() and 0 <= near < far):
        raise DatasetError(
            "no bounds fit these cameras",
            where=gathering.folder,
            why=f"near {near:.3g}, far {far:.3g}",
            remedy="check poses and intrinsics",
        )
    name = gathering.folder.resolve().name
    return Scene(
        name,
        views,
        near,
        far,
        box,
        "white" if masked else "scene",
        notes=tuple(gathering.notes),
        provenance=provenance,
        bounds_from=evidence,
    )


def _has_nothing(views: Sequence[View]) -> bool:
    """True where a mask or an alpha says of some pixels that there is nothing; of five views, an opaque alpha says nothing."""
    chosen = [views[i] for i in sorted({int(i) for i in np.linspace(0, len(views) - 1, 5)})]
    having = [view for view in chosen if view.mask is not None or images.channels(view.image) in (2, 4)]
    return any(float(view.read()[..., -1].min()) < 0.5 for view in having)


def with_points(scene: Scene, points: NDArray[np.float64]) -> Scene:
    """The scene with (n, 3) surface points, and box and near from them where no mask gave better ones."""
    found = bounds.about_points(scene.views, points)
    if scene.background == "white" or found is None:
        return replace(scene, points=points)
    return replace(scene, points=points, box=found[0], near=found[1], bounds_from=f"{len(points)} points of the model")
