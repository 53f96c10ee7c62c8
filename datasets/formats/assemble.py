"""Shared by the readers of foreign formats: missing files, image sizes, background and bounds."""

import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, KoalaError
from koala3d.datasets.formats.finding import masks
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import SAME_SHAPE, Scene, View, checked_name
from koala3d.datasets.structure import bounds
from koala3d.datasets.structure.masks.outlined import outlined

SHORTEST, LONGEST = 1e-3, 1e6
"""Range of plausible focal lengths, in image widths."""
SCALED = 1e-3
"""Scale of a rotation that more than rounding explains."""
SAMPLED, LEAST_VALID = 4, 0.3
"""Pixels along each axis for each that is asked for its ray; share of pixels with a ray below which a view is of no use."""
FEW = 0.25
"""Share of views without a mask up to which they are left out; of more, the masks are."""
IGNORED = "masks are white at all edges of the pictures: what is black is ignored, and is not the background of an object"
CAMERAS_ALONE = "cameras alone"
"""`Scene.bounds_from` where only the poses of the cameras are known."""


@dataclass
class Gathering:
    """Views read one by one, and the problems found while reading."""

    folder: Path
    problems: list[KoalaError] | None = None
    """Where errors go; None raises them."""
    views: list[View] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    rescaled: list[str] = field(default_factory=list)
    """Both sizes, for each view whose image has another size than its camera."""
    scales: list[float] = field(default_factory=list)
    """Scale that the rotation of each pose had and that was divided out."""
    tagged: list[str] = field(default_factory=list)
    """Names of images whose EXIF orientation says that a viewer turns them."""

    def complain(self, error: KoalaError) -> None:
        """Collect an error, or raise it."""
        if self.problems is None:
            raise error
        self.problems.append(error)

    @contextmanager
    def collecting(self) -> Iterator[None]:
        """Collect an error that ends the block, or raise it."""
        try:
            yield
        except KoalaError as error:
            self.complain(error)

    def file(self, path: Path, *, where: object) -> Path:
        """`path`, which begins with the folder; raises DatasetError where it leaves it, also through a symbolic link."""
        return files.within(self.folder, path, where=where)

    def masks(self, home: Path, names: Sequence[str]) -> list[Path | None]:
        """Mask of each image of `names` below `home`; None for images that have none. Collects problems as `complain` does."""
        found: list[Path | None] = [None] * len(names)
        with self.collecting():
            found, note = masks.find(self.folder, home, names)
            self.notes += [note] if note else []
        return [self.file(mask, where=mask) if mask else None for mask in found]

    def fitted(self, camera: Camera, picture: Path, *, where: object) -> Camera:
        """`fitted` of this module; images of another size than their camera, or with an orientation tag, are recorded."""
        found = fitted(camera, picture, where=where)
        if images.orientation(picture) != 1:
            self.tagged.append(picture.name)
        if (found.width, found.height) != (camera.width, camera.height):
            self.rescaled.append(f"{camera.width}x{camera.height} for an image of {found.width}x{found.height}")
        return found

    def finished(self, *, listed_in: str) -> tuple[View, ...]:
        """The views, checked, with notes on missing and rescaled images.

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
        if any(abs(scale - 1) > SCALED for scale in self.scales):
            least, most = min(self.scales), max(self.scales)
            self.notes.append(f"rotations have a scale of {least:.4g} to {most:.4g}, which is divided out")
        if self.tagged:
            self.notes.append(
                f"{len(self.tagged)} images have an EXIF orientation, which is not followed: poses belong to the stored pixels"
            )
        if not self.views:
            why = f"{listed_in} lists {len(self.missing)}, none of which exists" if self.missing else f"{listed_in} lists none"
            raise DatasetError("scene has no images", where=self.folder, why=why, remedy="put the images in place")
        self._beyond_lenses()
        self._part_masks()
        self._tell_apart()
        for view in self.views:
            with self.collecting():
                checked_name(view.name, where=self.folder / listed_in)
        with self.collecting():
            listed_once([view.name for view in self.views], where=self.folder / listed_in)
        return tuple(self.views)

    def _beyond_lenses(self) -> None:
        """Say how many pixels have no ray. Complain of pictures that have hardly any."""
        shares: dict[Camera, float] = {}
        for view in self.views:
            if view.camera not in shares:
                small = view.camera.scaled(*(max(side // SAMPLED, 1) for side in (view.camera.width, view.camera.height)))
                valid = small.valid_pixels()
                shares[view.camera] = 1.0 if valid is None else float(valid.mean())
        found = [shares[view.camera] for view in self.views]
        least = min(found)
        if least < LEAST_VALID:
            view = self.views[found.index(least)]
            why = f"its formula can be inverted at {least:.0%} of the pixels, within 89 degrees of the axis"
            remedy = "check the coefficients, or cut perspective images from the pictures"
            self.complain(DatasetError("lens is not usable", where=f"{self.folder}, view {view.name}", why=why, remedy=remedy))
        elif least < 1:
            count = sum(share < 1 for share in found)
            said = f"up to {1 - least:.0%} of the pixels of {count} views have no ray"
            self.notes.append(
                f"{said}: the lens's formula ends there, or they look more than 89 degrees aside; they take no part"
            )

    def _part_masks(self) -> None:
        """Leave out the few views without a mask, since their background is not the others'; or the few masks."""
        without = [view for view in self.views if view.mask is None]
        if not 0 < len(without) < len(self.views):
            return
        names = f"{', '.join(view.name for view in without[:5])}{', ...' if len(without) > 5 else ''}"
        if len(without) <= FEW * len(self.views):
            self.views = [view for view in self.views if view.mask is not None]
            self.notes.append(f"{len(without)} views without a mask are left out: {names}")
        else:
            count = len(self.views) - len(without)
            self.views = [replace(view, mask=None) for view in self.views]
            self.notes.append(f"masks of {count} views are not used, since {len(without)} others have none: {names}")

    def _tell_apart(self) -> None:
        """Add the suffix to names that several images share, such as `a` for `a.jpg` and `a.png`."""
        counts = Counter(view.name for view in self.views)
        self.views = [
            replace(view, name=f"{view.name}_{view.image.suffix[1:]}") if counts[view.name] > 1 else view for view in self.views
        ]


def listed_once(names: Iterable[object], *, where: object) -> None:
    """Raise DatasetError where a name occurs twice. Lists are checked before their images are opened, which takes longer."""
    twice = next((name for name, count in Counter(map(str, names)).items() if count > 1), None)
    if twice is not None:
        raise DatasetError("view is listed twice", where=f"{where}, {twice}")


def fitted(camera: Camera, picture: Path, *, where: object) -> Camera:
    """The camera at the size of its image, which must have the same aspect ratio; files often describe larger images.

    Raises:
        DatasetError: the image has another aspect ratio, or cannot be read.
    """
    width, height = images.size(picture)
    camera = camera.checked(where=where)
    if (width, height) == (camera.width, camera.height):
        return camera
    if abs(width * camera.height / (height * camera.width) - 1) > SAME_SHAPE:
        why = f"it is {width}x{height}, the file says {camera.width}x{camera.height}"
        remedy = "use the images that it was made for"
        if images.orientation(picture) >= 5:
            remedy = "its EXIF orientation is not followed; if the poses were made for upright pictures, turn the stored ones"
        raise DatasetError("image has another shape than its camera", where=where, why=why, remedy=remedy)
    return camera.scaled(width, height)


def foreign_lens(model: str, folder: Path, *, where: object) -> DatasetError:
    """The error of a lens that our camera cannot hold, and the command that mends it."""
    new = f"{folder.resolve().name}_undistorted"
    remedy = f"make a copy without distortion: datasets edit {shlex.quote(str(folder))} --undistort --out {shlex.quote(new)}"
    return DatasetError(f"camera model {model} is not supported", where=where, remedy=remedy)


def scene(gathering: Gathering, views: tuple[View, ...], format: str, *, near_far: tuple[float, float] | None = None) -> Scene:
    """Scene of a format that states neither background nor box: both come from images and cameras.

    Views with an alpha or a mask show an object alone ("white"), and its box is the visual hull's. Otherwise the surroundings
    are visible ("scene"), and the box is where the cameras look.
    """
    for view in views:
        focal = np.array([view.camera.fx, view.camera.fy]) / view.camera.width
        if not ((focal > SHORTEST) & (focal < LONGEST)).all():
            why = f"fx {view.camera.fx:.3g}, fy {view.camera.fy:.3g} at a width of {view.camera.width}"
            raise DatasetError("focal length is out of range", where=f"{gathering.folder}, view {view.name}", why=why)
    found = outlined(views)
    if found.inverted:
        gathering.notes.append(f"masks show the object in black: {found.inverted}")
        views = tuple(replace(view, mask_inverted=True) for view in views)
    if found.ignored:
        gathering.notes.append(IGNORED)
        views = tuple(replace(view, mask=None, ignored=view.mask) for view in views)
    if found.box is not None:
        box, near, far = found.box, found.near, found.far
        if near_far is not None and max(near, near_far[0]) < min(far, near_far[1]):  # else they describe something else
            near, far = max(near, near_far[0]), min(far, near_far[1])
        evidence = f"masks or alpha of {found.views_used} views" if found.views_used else CAMERAS_ALONE
    else:
        train = tuple(view for view in views if view.split == "train") or views
        box, near, far = bounds.surroundings(train)
        evidence = CAMERAS_ALONE
        if near_far is not None:
            near, far = near_far
            evidence += "; near and far as stated"
            if bounds.focus(np.stack([view.world_from_camera for view in train]))[1] < bounds.PARALLEL:
                box = bounds.frustum_box(train, near, far)
    if not (np.isfinite(box).all() and 0 <= near < far):
        why, remedy = f"near {near:.3g}, far {far:.3g}", "check poses and intrinsics"
        raise DatasetError("no bounds fit these cameras", where=gathering.folder, why=why, remedy=remedy)
    name, notes = gathering.folder.resolve().name, tuple(gathering.notes)
    provenance = {"format": format, "source": str(gathering.folder.absolute())}
    background = "scene" if found.box is None else "white"
    return Scene(name, views, near, far, box, background, notes=notes, provenance=provenance, bounds_from=evidence)


def with_points(scene: Scene, points: NDArray[np.float64]) -> Scene:
    """The scene with (n, 3) surface points; without masks, box and near are taken from them."""
    found = bounds.about_points(scene.views, points)
    if scene.background == "white" or found is None:
        return replace(scene, points=points)
    return replace(scene, points=points, box=found[0], near=found[1], bounds_from=f"{len(points)} points of the model")
