"""A scene in memory: posed cameras whose images are read on demand. Readers make it, everything else uses it.

The world frame is that of the source (the robot's base for a capture), z up where the source says so, in metres
where the source is metric.
"""

import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.imaging import images, marks, reduced

SPLITS = ("train", "val", "test")
LampsName = Literal["room", "camera", "object"]
LAMPS: tuple[LampsName, ...] = get_args(LampsName)
"""What lamps stand on: the room, as the robot's base does; the camera; or the object and what moves it."""
CHANNELS = ("normals", "depth", "alpha", "diffuse", "specular")
"""What there can be ground truth of."""
LIGHT = ("diffuse", "specular")
"""Those of them that are linear light."""
LONGEST_NAME = 200
"""Longest name of a view [bytes]; as a file it gets a prefix and a suffix."""
MASKS_FROM, PICTURES = "masks_from", "pictures"
"""Part of the provenance of a scene that `datasets mask` has written, and its value if the masks were found in the pictures."""
TURNED = "turned"
"""Part of the provenance of a scene of two sessions: the object's motion, its deviation, and the second session's `views`."""
STATED = "stated"
"""`Scene.bounds_from` where the source says where the object is."""
SAME_SHAPE = 0.02
"""Relative difference of aspect ratios that rounding to pixels can cause."""
LOSSY = frozenset({".jpg", ".jpeg"})
"""Suffixes of formats that change values a little."""
BLACK = 0.02
"""Share of black from which a pixel is ignored: less is the noise of compression."""
DISPARITY = "_disp"
"""Name suffix of depth files that hold Shiny Blender's 1 / (1 + distance along the ray)."""


def checked_name(name: object, *, where: object) -> str:
    """`name`, if it can name a view and its files; else a DatasetError."""
    usable = isinstance(name, str) and name.strip(".") and not any(unicodedata.category(c) in ("Cc", "Cs") for c in name)
    if not usable or len(str(name).encode()) > LONGEST_NAME:
        why = f"{str(name)[:40]!r} is empty, too long, or holds control characters"
        raise DatasetError("name of a view cannot name a file", where=where, why=why, remedy="rename the view")
    return str(name)


@dataclass(frozen=True)
class View:
    """One posed image."""

    name: str
    """Unique in the scene; sorts in the order of capture."""
    camera: Camera
    """Intrinsics at the size of the image on disk."""
    world_from_camera: NDArray[np.float64]
    """(4, 4), OpenCV camera axes."""
    split: str
    """"train", "val" or "test"."""
    image: Path
    mask: Path | None = None
    """Picture of the object: white is the object, black is ignored. `read_mask` says which variants there are."""
    truth: dict[str, Path] = field(default_factory=dict)
    """Ground truth, used by evaluation only, by channel."""
    depth_unit: float = 1e-3
    """World units per step of a depth file of integers; files of floats hold world units."""
    mask_inverted: bool = False
    """True where black is the object in the file of the mask."""
    ignored: Path | None = None
    """Picture whose black pixels take no part, neither in training nor in figures: a gripper, a hand, the rim of the lens."""
    deviation: Path | None = None
    """Standard deviation of the image's linear light, where the image is merged from several exposures."""
    white: float | None = None
    """Linear light of an EXR image that is read as white: darker light is divided by it, brighter light clipped. None: 1, and
    brighter light is read as more than 1."""
    base_from_world: NDArray[np.float64] | None = None
    """(4, 4) where the object, whose frame the world is, was in the room of the robot's base when the image was taken
    [world unit]. It turns with a turntable, and differs from before to after a person turned the object over. None: not known."""

    def read(self) -> NDArray[np.float32]:
        """(height, width, 3 or 4) sRGB in 0..1, alpha straight; a mask becomes the alpha.

        Grey becomes three equal channels. EXR holds linear light and is converted to sRGB, which may exceed 1 unless the view
        states its white.

        Raises:
            DatasetError: the file is missing, damaged, or of another size than the camera.
        """
        picture = reduced.in_colour(self.read_image())
        if self.image.suffix.lower() == ".exr":
            light = picture[..., :3] if self.white is None else np.minimum(picture[..., :3] / self.white, 1)
            picture = np.concatenate([images.srgb_from_linear(light), picture[..., 3:]], axis=-1)
        if self.mask is not None:
            picture = np.concatenate([picture[..., :3], self.read_mask()], axis=-1)
        return picture

    def read_resized(self, width: int, height: int) -> NDArray[Any]:
        """(height, width, 3 or 4) as `read`, but black where alpha is zero, and averaged over areas in linear light.

        Much faster than `read` and a resize where the wanted size [px] is much smaller; see `imaging.reduced`.

        Returns:
            float32; at the picture's own size uint8 or uint16 where its files hold that, for `images.as_float`.

        Raises:
            DatasetError: as `read`, and where values are not finite.
        """
        if images.steps(self.image) != 1 and (self.mask is None or images.steps(self.mask) != 1):
            self._require_channels(images.channels(self.image))
            self._require_size(*images.size(self.image), self.image)
            return reduced.read_resized(self.image, None if self.mask is None else self.read_stored_mask(), width, height)
        picture = reduced.visible(self.read())
        if not np.isfinite(picture).all():
            raise DatasetError("image holds values that are not finite", where=self.image, remedy="write it again")
        return picture if picture.shape[:2] == (height, width) else images.resize(picture, width, height)

    def read_small(self, side: int) -> NDArray[np.float32]:
        """(height, width, 3 or 4) as `read`, at most `side` pixels a side: values averaged as they are, also where alpha is zero.

        Much faster than `read` and a resize, in less memory. Raises as `read` does.
        """
        small = self.camera.within(side)
        if images.steps(self.image) == 1:
            return reduced.averaged(self.read(), small.width, small.height)
        self._require_channels(images.channels(self.image))
        self._require_size(*images.size(self.image), self.image)
        stored = reduced.read_stored(self.image, small.width, small.height)
        picture = reduced.in_colour(reduced.averaged(stored, small.width, small.height))
        return picture if self.mask is None else np.dstack([picture[..., :3], self.read_cover(small.width, small.height)])

    def read_deviation(self) -> NDArray[np.float32]:
        """(height, width, channels) standard deviation of the image's linear light.

        Raises:
            UsageError: it is not known.
            DatasetError: the file is missing, damaged, or of another size than the camera.
        """
        if self.deviation is None:
            raise UsageError("noise of the image is not known", where=f"view {self.name}", why="it has a single exposure")
        values = images.read(self.deviation)
        self._check_size(values, self.deviation)
        return values

    def counted(self, camera: Camera) -> NDArray[np.bool_] | None:
        """(height, width) pixels of `camera`, the view's at some size, that take part; None if all do.

        Those do not that the lens has no ray for, or of which `ignored` has any black. Raises DatasetError if it is damaged.
        """
        valid = camera.valid_pixels()
        if self.ignored is None:
            return valid
        as_mask = replace(self, mask=self.ignored, mask_inverted=False)
        white = as_mask.read_cover(camera.width, camera.height) > 1 - BLACK
        return white if valid is None else white & valid

    def read_image(self) -> NDArray[np.float32]:
        """The image alone, mask or not, with as many channels as its file has. Raises as `read` does."""
        return images.as_float(self.read_stored())

    def read_stored(self) -> NDArray[Any]:
        """`read_image` as the integers of its file, for `images.as_float`, or as float32."""
        stored = images.read_stored(self.image)
        self._check_size(stored, self.image)
        self._require_channels(stored.shape[-1])
        return stored

    def read_mask(self) -> NDArray[np.float32]:
        """(height, width, 1) of the mask at the size of the image: 1 on the object, 0 where it is not.

        A mask of another size is resized. Of several channels, an alpha that is not opaque everywhere counts, else the brightest
        colour. Labels (values of a tenth at most) become 1, and the noise of lossy compression near 0 and 1 is removed.

        Raises:
            UsageError: the view has no mask.
            DatasetError: the file is missing, damaged, or of another shape than the image.
        """
        return images.as_float(self.read_stored_mask())

    def read_stored_mask(self) -> NDArray[Any]:
        """`read_mask` as the integers of its file, for `images.as_float`, where they are used as they are; else as float32."""
        if self.mask is None:
            raise UsageError("view has no mask", where=f"view {self.name}")
        width, height = self.camera.width, self.camera.height
        mask = marks.marked(images.read_stored(self.mask))
        self._require_shape(mask.shape[1], mask.shape[0], self.mask)
        if mask.shape == (height, width, 1) and not (self.mask_inverted or self.mask.suffix.lower() in LOSSY):
            return mask
        return self._of_object(images.as_float(mask), width, height)

    def read_cover(self, width: int, height: int) -> NDArray[np.float32]:
        """(height, width) share of the object in each pixel of a smaller picture, by `read_mask`, else by the image's alpha.

        Without an alpha everything is the object's. Faster than `read_mask`, in less memory; raises as it does.
        """
        if self.mask is not None:
            self._require_shape(*images.size(self.mask), self.mask)
            mask = marks.marked(reduced.read_stored(self.mask, width, height))
            lossy = self.mask.suffix.lower() in LOSSY  # noise is taken from the pixels that were read, not from their means
            values = images.as_float(mask) if lossy else reduced.averaged(mask, width, height)
            return self._of_object(values, width, height)[..., 0]
        self._require_size(*images.size(self.image), self.image)
        if images.channels(self.image) not in (2, 4):
            return np.ones((height, width), np.float32)
        return reduced.averaged(images.read_stored(self.image)[..., -1:], width, height)[..., 0]

    def _of_object(self, mask: NDArray[np.float32], width: int, height: int) -> NDArray[np.float32]:
        """(height, width, 1) of the object, from the values of the mask's file at any size."""
        if self.mask is not None and self.mask.suffix.lower() in LOSSY:
            mask = marks.without_noise(mask)
        mask = images.resize(mask, width, height, srgb=False)
        return 1 - mask if self.mask_inverted else mask

    def read_truth(self, channel: str) -> NDArray[np.float32]:
        """(height, width, channels) of one truth map in physical values.

        "normals" are unit vectors in the world, zero where there is none (8-bit files hold (n + 1) / 2); "depth" is along
        z in world units; "alpha" is 0..1; "diffuse" and "specular" are linear light, 1 is the white of `read`.

        Raises:
            UsageError: the view has no such truth.
            DatasetError: the file is missing, damaged, or of another size than the camera.
        """
        if channel not in self.truth:
            why = f"it has {sorted(self.truth) or 'none'}"
            raise UsageError(f"no truth called {channel!r}", where=f"view {self.name}", why=why)
        path = self.truth[channel]
        values = images.read(path)
        self._check_size(values, path)
        if channel == "depth":
            return self._depth(values[..., :1], path)
        if channel in LIGHT and self.white is not None:
            return values / np.float32(self.white)
        if channel != "normals":
            return values
        normals = values[..., :3] if path.suffix.lower() in images.FLOAT_SUFFIXES else 2 * values[..., :3] - 1
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        return np.where(length > 0.5, normals / np.maximum(length, 0.5), 0.0).astype(np.float32)

    def _depth(self, values: NDArray[np.float32], path: Path) -> NDArray[np.float32]:
        """Depth along z from a file's values; 0 where nothing was hit."""
        if path.stem.endswith(DISPARITY):
            lengths = np.linalg.norm(self.camera.directions(self.camera.pixel_centres()), axis=-1, keepdims=True)
            hit = values > 0
            return np.where(hit, (1 / np.where(hit, values, 1.0) - 1) / lengths, 0.0).astype(np.float32)
        steps = images.steps(path)
        return values if steps == 1 else values * np.float32(steps * self.depth_unit)

    def _require_shape(self, width: int, height: int, path: Path) -> None:
        """Raise where a picture cannot be resized to the image: its aspect ratio differs by more than rounding explains."""
        if abs(width * self.camera.height / (height * self.camera.width) - 1) > SAME_SHAPE:
            self._require_size(width, height, path)

    def _check_size(self, picture: NDArray[np.float32], path: Path) -> None:
        self._require_size(picture.shape[1], picture.shape[0], path)

    def _require_channels(self, count: int) -> None:
        if count not in (1, 2, 3, 4):
            raise DatasetError("image has too many channels", where=self.image, why=f"{count}", remedy="give RGB or RGBA")

    def _require_size(self, width: int, height: int, path: Path) -> None:
        if (width, height) != (self.camera.width, self.camera.height):
            where, why = (
                f"{path} (view {self.name})",
                f"it is {width}x{height}, its camera says {self.camera.width}x{self.camera.height}",
            )
            remedy = "use the images that the cameras were made for"
            raise DatasetError("image has the wrong size", where=where, why=why, remedy=remedy)


def with_test_views(views: Iterable[View], every: int) -> tuple[View, ...]:
    """The views with every `every`-th by sorted name, from the first on, as "test", the rest as "train"; 0 for no test views."""
    views = tuple(views)
    test = {view.name for view in sorted(views, key=lambda view: view.name)[::every]} if every > 0 else set()
    return tuple(replace(view, split="test" if view.name in test else "train") for view in views)


@dataclass(frozen=True, eq=False)
class Sightings:
    """Where views saw the points of a scene: the observations of bundle adjustment."""

    names: tuple[str, ...]
    """Names of the views."""
    index: NDArray[np.int64]
    """(m, 2) index of a point, and of a view in `names`."""
    pixels: NDArray[np.float64]
    """(m, 2) where the view saw it."""


@dataclass(frozen=True)
class Scene:
    """Views and what is known about the space they show."""

    name: str
    views: tuple[View, ...]
    near: float
    """Nearest distance along z at which a camera sees anything [world unit]."""
    far: float
    """Furthest such distance; infinity where there is open background."""
    box: NDArray[np.float64]
    """(2, 3) lower and upper corner of the object's bounding box in the world."""
    background: str
    """"white" where images carry an alpha or mask and the rest is empty; "scene" where the surroundings are seen."""
    metric: bool = False
    """True where the world unit is the metre."""
    points: NDArray[np.float64] | None = None
    """(n, 3) sparse surface points, where known."""
    colours: NDArray[np.uint8] | None = None
    """(n, 3) their sRGB, where known."""
    sightings: Sightings | None = None
    """Which views saw which of the points, where known."""
    notes: tuple[str, ...] = ()
    """What the reader had to assume or leave out, one line each."""
    provenance: dict[str, Any] = field(default_factory=dict)
    lamps: LampsName | None = None
    """One of `LAMPS`; None where the source does not say what the lamps stand on."""
    bounds_from: str = STATED
    """Evidence for near, far and box, the box's first: "stated", "cameras alone", or how many points or masks."""

    @property
    def box_is_stated(self) -> bool:
        """True where the source states the object's box; elsewhere it is estimated from images or cameras."""
        return self.bounds_from.removeprefix("box ").startswith(STATED)

    @property
    def masks_were_found(self) -> bool:
        """Whether `datasets mask` found masks of this scene, or of one that it was merged from, in the pictures."""
        return any(source.get(MASKS_FROM) == PICTURES for source in self.provenance.get("merged", [self.provenance]))

    def split(self, name: str) -> tuple[View, ...]:
        """Views of one split. Raises UsageError where there are none."""
        chosen = tuple(view for view in self.views if view.split == name)
        if not chosen:
            found = sorted({view.split for view in self.views})
            raise UsageError(f"scene has no {name} views", where=self.name, why=f"it has {', '.join(found) or 'no views at all'}")
        return chosen

    def counts(self) -> dict[str, int]:
        """Number of views of each split."""
        return {split: sum(view.split == split for view in self.views) for split in SPLITS}

    def with_views(self, views: tuple[View, ...]) -> Self:
        """The same scene with other views."""
        return replace(self, views=views)
