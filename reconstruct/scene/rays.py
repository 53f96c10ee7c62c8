"""From a scene's views to rays in the normalised scene, and to the table of pixels that training draws from."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging import images
from koala3d.datasets.imaging.copies import Copies
from koala3d.datasets.imaging.downscale import streamed
from koala3d.datasets.imaging.reduced import READERS
from koala3d.datasets.scene import Scene, View
from koala3d.reconstruct.numerics.safe import safe_norm
from koala3d.reconstruct.scene.frustum import Frustum
from koala3d.reconstruct.scene.light import LightFrame
from koala3d.reconstruct.scene.space import BALL, BOX, Space

BRIGHTEST = 6e4
"""Brighter colours are kept as this, which float16 can still hold."""
WORTH_A_COPY = 2**22
"""Pixels of a picture from which on its scaled copy is kept: smaller ones are decoded in a few hundredths of a second."""


class Rays(eqx.Module):
    """Rays in the normalised scene. `directions` have z = 1 in their camera, so that t is depth in scene units."""

    origins: Float[Array, "n 3"]
    directions: Float[Array, "n 3"]
    radii: Float[Array, " n"]
    """Radius of the pixel's cone at t = 1 [scene unit]: 2 / sqrt(12) of the pixel's width (Mip-NeRF, section 3)."""
    view: Int[Array, " n"] | None = None
    """Index of the training view; None outside training."""
    light: Float[Array, "n 3 3"] | None = None
    """Rotation from the scene's axes to those in which the lamps stand still; None where these are the scene's."""

    @property
    def speed(self) -> Float[Array, " n"]:
        """Length of the directions."""
        return safe_norm(self.directions)

    @property
    def viewdirs(self) -> Float[Array, "n 3"]:
        """Unit directions."""
        return self.directions / self.speed[:, None]


@dataclass(frozen=True)
class Normalisation:
    """The similarity `scene_from_world`: x_scene = (x_world - centre) * scale. Kept with the model; exports undo it."""

    centre: tuple[float, float, float]
    scale: float
    bounded: bool
    """True where everything lies in the cube [-1, 1]^3; else surroundings are contracted."""
    near: float
    """Nearest depth [scene unit]."""
    far: float
    """Furthest depth [scene unit]."""
    backdrop: bool = False
    """True where surroundings are allowed for although the pictures' background is blank."""
    frustum: Frustum | None = None
    """What the cameras see, where they all look the same way and it takes the place of the contraction."""

    @classmethod
    def of(cls, scene: Scene, *, backdrop: bool = False) -> "Normalisation":
        """The object's box into the cube where it is all there is, into the unit ball where there are surroundings."""
        low, high = np.asarray(scene.box, np.float64)
        bounded = scene.background == "white"
        reach = (high - low).max() / 2 if bounded else np.linalg.norm(high - low) / 2
        scale = float(1 / max(reach, 1e-12))
        far = scene.far * scale if np.isfinite(scene.far) else 1e3
        return cls(tuple(((low + high) / 2).tolist()), scale, bounded, float(scene.near * scale), float(min(far, 1e3)), backdrop)

    @property
    def space(self) -> Space:
        """Where the field lives."""
        return BOX if self.bounded else self.frustum or BALL


def view_rays(
    view: View, normalisation: Normalisation, camera: Camera | None = None, index: Int[np.ndarray, " n"] | None = None
) -> tuple[NDArray, NDArray, NDArray]:
    """Origins, directions (n, 3) and radii (n,) of pixels of a view, float32, in the normalised scene.

    Args:
        camera: the view's, where another one than that of the file is wanted.
        index: of the pixels, counted row by row; None: all of them.
    """
    camera = camera or view.camera
    world_from_camera = view.world_from_camera
    if index is None:
        centres = camera.pixel_centres().reshape(-1, 2)
    else:
        centres = np.stack([index % camera.width, index // camera.width], -1) + 0.5
    directions = camera.directions(centres) @ world_from_camera[:3, :3].T
    origin = (world_from_camera[:3, 3] - normalisation.centre) * normalisation.scale
    radii = np.full(len(directions), 2 / np.sqrt(12) / np.sqrt(camera.fx * camera.fy))
    return np.broadcast_to(origin, directions.shape).astype(np.float32), directions.astype(np.float32), radii.astype(np.float32)


def direction_of_cameras(views: tuple[View, ...], normalisation: Normalisation) -> tuple[float, float, float]:
    """Mean unit direction from the scene's origin to where the views were taken: near zero where they are all around."""
    positions = np.stack([view.world_from_camera[:3, 3] for view in views]) - normalisation.centre
    directions = positions / np.maximum(np.linalg.norm(positions, axis=-1, keepdims=True), 1e-12)
    x, y, z = directions.mean(0).tolist()
    return x, y, z


def scaled_camera(view: View, scale: float) -> Camera:
    """The camera of a view whose image is resampled to `scale` of its size."""
    return view.camera.scaled(max(1, round(view.camera.width * scale)), max(1, round(view.camera.height * scale)))


def pixel_counts(views: tuple[View, ...], scale: float) -> Int[np.ndarray, " views"]:
    """Pixels of each view at `scale` of its size."""
    cameras = [scaled_camera(view, scale) for view in views]
    return np.array([camera.width * camera.height for camera in cameras], np.int64)


def stored_pixels(view: View, scale: float, copies: Copies | None = None) -> Shaped[np.ndarray, "height width channels"]:
    """`read_scaled`, for `images.as_float`: perhaps integers, and read-only where it comes from `copies`."""
    camera = scaled_camera(view, scale)
    size = camera.width, camera.height
    if copies is None or view.camera.width * view.camera.height < WORTH_A_COPY:
        return view.read_resized(*size)
    sources, how = [path for path in (view.image, view.mask) if path], "black is the object" if view.mask_inverted else ""
    return copies.of(sources, *size, lambda: view.read_resized(*size), how=how)


def read_scaled(view: View, scale: float, copies: Copies | None = None) -> Float[np.ndarray, "height width channels"]:
    """A view's picture (sRGB, straight alpha) at `scale` of its size, averaged over areas in linear light.

    Args:
        copies: where large pictures are kept at this size, for the next time.
    """
    return np.array(images.as_float(stored_pixels(view, scale, copies)))


def over(picture: Shaped[Any, "... channels"], background: float | Float[Any, "... 3"] = 1.0) -> Float[Any, "... 3"]:
    """Colours over a background, white unless another is given; as they are where there is no alpha beside them."""
    if picture.shape[-1] == 3:
        return picture
    alpha = picture[..., 3:]
    return picture[..., :3] * alpha + (1 - alpha) * background


def training_colours(stored: Shaped[np.ndarray, "*pixels channels"]) -> Float[np.ndarray, "n 4"]:
    """Pixels of `stored_pixels` as training has them: sRGB and straight alpha, float16."""
    channels = stored.shape[-1]
    colours = np.ones((stored.size // channels, 4), np.float16)
    flat = stored.reshape(-1, channels)
    if stored.dtype == np.float32:
        colours[:, :channels] = np.clip(flat, -BRIGHTEST, BRIGHTEST)
    else:
        steps = np.arange(np.iinfo(stored.dtype).max + 1, dtype=stored.dtype)
        colours[:, :channels] = images.as_float(steps).astype(np.float16)[flat]
    return colours


def pixels_over_white(rays: Rays, colour: Float[Array, "n 4"]) -> tuple[Any, ...]:
    """(origins, directions, radii, light or None, colour over white) of pixels, on the host."""
    light = None if rays.light is None else np.asarray(rays.light)
    return np.asarray(rays.origins), np.asarray(rays.directions), np.asarray(rays.radii), light, over(np.asarray(colour))


def view_pixels(
    view: View, normalisation: Normalisation, scale: float, copies: Copies | None, index: Int[np.ndarray, " n"] | None
) -> tuple[Float[np.ndarray, "n 4"], Float[np.ndarray, "n 3"]]:
    """Colours and directions of pixels of a view, as `Pixels` has them; `index` as of `view_rays`."""
    stored, camera = stored_pixels(view, scale, copies), scaled_camera(view, scale)
    index = _of_counted(view, camera, index)
    colours = stored if index is None else stored.reshape(-1, stored.shape[-1])[index]
    return training_colours(colours), view_rays(view, normalisation, camera, index)[1]


def _of_counted(view: View, camera: Camera, index: Int[np.ndarray, " n"] | None) -> Int[np.ndarray, " n"] | None:
    """The index with other pixels of the view, drawn at random, in place of those that take no part."""
    counted = view.counted(camera)
    if counted is None:
        return index
    found = np.arange(counted.size) if index is None else index.copy()
    wrong = ~counted.ravel()[found]
    found[wrong] = np.random.default_rng(len(found)).choice(np.flatnonzero(counted), int(wrong.sum()))
    return found


def round_length(count: int) -> int:
    """The next of sixteen lengths between a power of two and the next: at most a sixteenth is filling. At least 16."""
    step = 2 ** max(count.bit_length() - 5, 0)
    return max(-(-count // step) * step, 16)


class Pixels(eqx.Module):
    """Every training pixel: its colour and its ray. Origins are kept per view."""

    colour: Float[Array, "pixels 4"]
    """sRGB and straight alpha (1 where the image has none), float16."""
    directions: Float[Array, "pixels 3"]
    view: Int[Array, " pixels"]
    origins: Float[Array, "views 3"]
    radii: Float[Array, " views"]
    light: Float[Array, "views 3 3"] | None = None
    """See `Rays`."""
    count: Int[Array, ""] | None = None
    """How many pixels there are, if more follow that only fill the arrays; None: all are pixels."""

    @property
    def total(self) -> int | Int[Array, ""]:
        """How many pixels there are."""
        return self.directions.shape[0] if self.count is None else self.count

    def chosen(self, those: Bool[np.ndarray, " pixels"]) -> "Pixels":
        """Some of the pixels."""
        arrays = {name: jnp.asarray(np.asarray(getattr(self, name))[those]) for name in ("colour", "directions", "view")}
        return replace(self, **arrays)

    def filled_up(self) -> "Pixels":
        """The same in arrays of one of few lengths, so that what was compiled for one scene serves others of about its size."""
        return self.filled(round_length(self.directions.shape[0]), round_length(self.origins.shape[0]))

    def filled(self, pixels: int, views: int) -> "Pixels":
        """The same in arrays of these lengths, which are not below those that they have."""
        fill = lambda a, length: jnp.concatenate([a, jnp.zeros((length - len(a), *a.shape[1:]), a.dtype)])  # noqa: E731
        of_pixels = {name: fill(getattr(self, name), pixels) for name in ("colour", "directions", "view")}
        of_views = {name: fill(getattr(self, name), views) for name in ("origins", "radii")}
        light = None if self.light is None else fill(self.light, views)
        return replace(self, **of_pixels, **of_views, light=light, count=jnp.asarray(self.total, jnp.int32))

    @classmethod
    def load(
        cls,
        views: tuple[View, ...],
        normalisation: Normalisation,
        scale: float,
        progress,
        *,
        copies: Copies | None = None,
        chosen: Sequence[Int[np.ndarray, " _"]] | None = None,
    ) -> "Pixels":
        """Read the pixels of `views`, as many pictures at a time as there are cores.

        Args:
            copies: where large pictures are kept, see `read_scaled`.
            chosen: of each view, the pixels that are wanted, counted row by row; None: all of them.
        """
        cameras = [scaled_camera(view, scale) for view in views]
        whole = chosen or [None] * len(views)
        counts = pixel_counts(views, scale) if chosen is None else np.array([len(index) for index in chosen])
        colour, direction = np.empty((counts.sum(), 4), np.float16), np.empty((counts.sum(), 3), np.float32)
        parts = streamed(
            lambda part: view_pixels(part[0], normalisation, scale, copies, part[1]),
            zip(views, whole, strict=True),
            workers=READERS,
        )
        for part, end, count in zip(parts, np.cumsum(counts), counts, strict=True):
            colour[end - count : end], direction[end - count : end] = part
            progress.advance()
        owner = np.repeat(np.arange(len(views), dtype=np.int32), counts)
        first = [view_rays(view, normalisation, camera, np.zeros(1, int)) for view, camera in zip(views, cameras, strict=True)]
        origins, radii = (np.concatenate([rays[i] for rays in first]) for i in (0, 2))
        arrays: list[Any] = [jnp.asarray(array) for array in (colour, direction, owner, origins, radii)]
        return cls(*arrays)

    def under(self, light: LightFrame, views: tuple[View, ...]) -> "Pixels":
        """The same pixels of these views, with their lamps' frame."""
        found = light.of_views(views)
        return self if found is None else replace(self, light=jnp.asarray(found))

    def over_white(self, index: Int[np.ndarray, " n"]) -> tuple[Any, ...]:
        """(origins, directions, radii, light or None, colour over white) of some pixels."""
        return pixels_over_white(*self.take(jnp.asarray(index)))

    def take(self, index: Array) -> tuple[Rays, Float[Array, "n 4"]]:
        """Rays and colours (float32) of the given pixels."""
        get = lambda a, i: a.at[i].get(mode="promise_in_bounds")  # noqa: E731
        view = get(self.view, index)
        light = None if self.light is None else get(self.light, view)
        rays = Rays(get(self.origins, view), get(self.directions, index), get(self.radii, view), view, light)
        return rays, get(self.colour, index).astype(jnp.float32)
