"""From a scene's views to rays in the normalised scene, and to the table of pixels that training draws from."""

from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped
from numpy.typing import NDArray

from datasets.camera_model import Camera
from datasets.imaging import images
from datasets.scene import Scene, View
from reconstruct.numerics.safe import safe_norm
from reconstruct.scene.light import LightFrame

BRIGHTEST = 6e4
"""Brighter colours are kept as this, which float16 can still hold."""


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

    @classmethod
    def of(cls, scene: Scene, *, backdrop: bool = False) -> "Normalisation":
        """The object's box into the cube where it is all there is, into the unit ball where there are surroundings."""
        low, high = np.asarray(scene.box, np.float64)
        bounded = scene.background == "white"
        reach = (high - low).max() / 2 if bounded else np.linalg.norm(high - low) / 2
        scale = float(1 / max(reach, 1e-12))
        far = scene.far * scale if np.isfinite(scene.far) else 1e3
        return cls(tuple(((low + high) / 2).tolist()), scale, bounded, scene.near * scale, min(far, 1e3), backdrop)


def view_rays(view: View, normalisation: Normalisation, camera: Camera | None = None) -> tuple[NDArray, NDArray, NDArray]:
    """All pixels of a view, row by row: origins, directions (n, 3) and radii (n,), float32, in the normalised scene."""
    camera = camera or view.camera
    world_from_camera = view.world_from_camera
    in_camera = camera.directions(camera.pixel_centres()).reshape(-1, 3)
    directions = in_camera @ world_from_camera[:3, :3].T
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


def read_scaled(view: View, scale: float) -> Float[np.ndarray, "height width channels"]:
    """A view's picture (sRGB, straight alpha) at `scale` of its size, averaged over areas in linear light."""
    picture = view.read()
    if picture.shape[-1] == 4:  # what a mask hides may be anything, also nothing at all
        picture = np.where(picture[..., 3:] == 0, np.float32(0), picture)
    if not np.isfinite(picture).all():
        from datasets.core.errors import DatasetError

        raise DatasetError("image holds values that are not finite", where=view.image, remedy="write it again")
    camera = scaled_camera(view, scale)
    if picture.shape[:2] != (camera.height, camera.width):
        picture = images.resize(picture, camera.width, camera.height)
    return picture


def over(picture: Shaped[Any, "... channels"], background: float | Float[Any, "... 3"] = 1.0) -> Float[Any, "... 3"]:
    """Colours over a background, white unless another is given; as they are where there is no alpha beside them."""
    if picture.shape[-1] == 3:
        return picture
    alpha = picture[..., 3:]
    return picture[..., :3] * alpha + (1 - alpha) * background


def pixels_over_white(rays: Rays, colour: Float[Array, "n 4"]) -> tuple[Any, ...]:
    """(origins, directions, radii, light or None, colour over white) of pixels, on the host."""
    light = None if rays.light is None else np.asarray(rays.light)
    return np.asarray(rays.origins), np.asarray(rays.directions), np.asarray(rays.radii), light, over(np.asarray(colour))


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

    @classmethod
    def load(cls, views: tuple[View, ...], normalisation: Normalisation, scale: float, progress) -> "Pixels":
        """Read all images of `views`, one at a time."""
        colours, directions, owner, origins, radii = [], [], [], [], []
        for index, view in enumerate(views):
            picture = read_scaled(view, scale)
            if picture.shape[-1] == 1:
                picture = np.repeat(picture, 3, -1)
            if picture.shape[-1] == 3:
                picture = np.concatenate([picture, np.ones_like(picture[..., :1])], -1)
            origin, direction, radius = view_rays(view, normalisation, scaled_camera(view, scale))
            colours.append(np.clip(picture.reshape(-1, 4), -BRIGHTEST, BRIGHTEST).astype(np.float16))
            directions.append(direction)
            owner.append(np.full(len(direction), index, np.int32))
            origins.append(origin[0])
            radii.append(radius[0])
            progress.advance()
        colour, direction, view = (jnp.asarray(np.concatenate(parts)) for parts in (colours, directions, owner))
        return cls(colour, direction, view, jnp.asarray(np.stack(origins)), jnp.asarray(np.stack(radii)))

    def lit(self, light: LightFrame, views: tuple[View, ...]) -> "Pixels":
        """The same pixels of these views, with their lamps' frame."""
        found = light.of_views(views)
        return self if found is None else replace(self, light=jnp.asarray(found))

    def held_out(self, count: int) -> tuple["Pixels", "Pixels"]:
        """The pixels without up to `count` random ones (a hundredth of all at most), and those; always the same ones."""
        total = self.directions.shape[0]
        held = np.random.default_rng(0).choice(total, max(1, min(count, total // 100)), replace=False)
        rest = np.setdiff1d(np.arange(total), held)

        def part(index: Int[np.ndarray, " n"]) -> Pixels:
            return replace(self, colour=self.colour[index], directions=self.directions[index], view=self.view[index])

        return part(rest), part(held)

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
