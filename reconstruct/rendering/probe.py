"""Pixels that a training never sees: of test views for the log, of training views for an early stop."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from koala3d.datasets.core.console import progress
from koala3d.datasets.imaging.copies import Copies
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.rendering.exposure import across_halves, left_half
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.rendering.pictures import Renderer
from koala3d.reconstruct.scene.light import STILL, LightFrame
from koala3d.reconstruct.scene.poses import spread_of
from koala3d.reconstruct.scene.rays import Normalisation, Pixels, Rays, pixel_counts, scaled_camera
from koala3d.reconstruct.scene.twists import moved

PIXELS, VIEWS = 4096, 4
"""Pixels of test views that each line of the log measures, not part of the training's time; views that they are from."""


class Probe(NamedTuple):
    """Random pixels of a few test views."""

    origins: Float[np.ndarray, "n 3"]
    directions: Float[np.ndarray, "n 3"]
    radii: Float[np.ndarray, " n"]
    light: Float[np.ndarray, "n 3 3"] | None
    """See `Rays`."""
    colour: Float[np.ndarray, "n 3"]
    """Over white."""
    view: Int[np.ndarray, " n"]
    left: Bool[np.ndarray, " n"]
    """Whether the pixel is in the left half of its picture."""
    session: Float[np.ndarray, "views 6 6"] | None = None
    """`Session.spread` of the test views, where the object was turned over."""

    @classmethod
    def of(
        cls,
        scene: Scene,
        config: Config,
        normalisation: Normalisation,
        copies: Copies | None = None,
        light: LightFrame = STILL,
    ) -> "Probe | None":
        """The same pixels for every training of a scene; None where there are no test views.

        Args:
            copies: where large pictures are kept, see `read_scaled`.
            light: where the scene's lamps stand still.
        """
        views = [view for view in scene.views if view.split == "test"]
        if not views:
            return None
        views = tuple(views[:: max(1, len(views) // VIEWS)][:VIEWS])
        ends = np.cumsum(pixel_counts(views, config.scale))
        index = np.random.default_rng(0).choice(ends[-1], min(PIXELS, ends[-1]), replace=False)
        owner = np.searchsorted(ends, index, side="right")
        chosen = [index[owner == view] - start for view, start in enumerate(np.concatenate([[0], ends[:-1]]))]
        with progress("reading unseen pixels", len(views), "images") as shown:
            pixels = Pixels.load(views, normalisation, config.scale, shown, copies=copies, chosen=chosen)
        as_drawn = np.argsort(np.argsort(owner, kind="stable"), kind="stable")
        cameras = [scaled_camera(view, config.scale) for view in views]
        left = np.concatenate([left_half(camera.height, camera.width).ravel() for camera in cameras])
        origins, directions, radii, lamps, colour = pixels.under(light, views).over_white(as_drawn)
        session = spread_of(scene, views, normalisation)
        return cls(origins, directions, radii, lamps, colour, owner.astype(np.int32), left[index], session)

    def psnr(self, model: Model, renderer: Renderer) -> float:
        """PSNR [dB]; where views have gains, each half of a picture with the exposure that fits the other.

        Views of a second session are where the model has learned that it is.
        """
        rendered = renderer.rays(model, *self._seen_from(model), self.radii, self.light)
        rgb = rendered["rgb"]
        if model.per_image is not None:
            rgb, gains = rgb.copy(), model.per_image.shape[1]
            for view in np.unique(self.view):
                own = self.view == view
                maps = {name: rendered[name][own] for name in ("rgb", "opacity")}
                rgb[own], _ = across_halves(maps, self.colour[own], self.left[own], renderer.behind[0], gains)
        return _psnr(rgb, self.colour)

    def _seen_from(self, model: Model) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Origins and directions."""
        if self.session is None or model.session is None:
            return self.origins, self.directions
        given = Rays(*map(jnp.asarray, (self.origins, self.directions, self.radii, self.view)))
        rays = moved(given, jnp.asarray(self.session, jnp.float32) @ model.session.by)
        return np.asarray(rays.origins), np.asarray(rays.directions)


def _psnr(rendered: Float[np.ndarray, "n 3"], target: Float[np.ndarray, "n 3"]) -> float:
    return -10 * float(np.log10(max(np.mean((rendered - target) ** 2), 1e-10)))
