"""The wipe of a run's page: beside the model, a photograph or the run's asset from the same viewpoint."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import viser
from numpy.typing import NDArray

from koala3d.datasets.imaging import images
from koala3d.datasets.scene import View
from koala3d.reconstruct.page import compose
from koala3d.reconstruct.page.compose import Viewpoint
from koala3d.reconstruct.path_tracing.reading import StoredAsset, read
from koala3d.reconstruct.path_tracing.stage import Stage, over_white, require_mitsuba

Picture = NDArray[np.float32]

NOTHING, PHOTOGRAPH, ASSET = "nothing", "nearest training image", "asset"
PATHS = 8
"""Light paths per pixel of the asset: a second for a sharp picture."""


@dataclass
class LitAsset:
    """An asset under its light, by Mitsuba, which is loaded with the first picture: in the thread that renders."""

    asset: StoredAsset
    light: Path
    _stage: Stage | None = field(default=None, init=False)

    def picture(self, viewpoint: Viewpoint, rays: int, turn: float) -> Picture:
        """(height, width, 3) sRGB over white, with about `rays` pixels.

        Args:
            turn: of the light about the asset's upward axis [rad].
        """
        if self._stage is None:
            self._stage = Stage(self.asset, self.light)
        self._stage.turn_light(turn)
        camera = viewpoint.camera(rays)
        shown = over_white(self._stage.picture(viewpoint.view(camera), camera, paths=PATHS, seed=0))
        return np.asarray(shown, np.float32)


class Wipe:
    """What is shown right of the wipe, and its controls."""

    def __init__(self, gui: viser.GuiApi, views: tuple[View, ...], reach: float, asset: LitAsset | None) -> None:
        """Add the controls to a page.

        Args:
            views: of the photographs.
            reach: distance [world unit] that counts as much as a radian, see `compose.nearest_view`.
            asset: None leaves it out of the choice.
        """
        self._views, self._reach, self._asset = views, reach, asset
        self._photograph: tuple[str, Picture] | None = None
        choice = (NOTHING, PHOTOGRAPH) if asset is None else (NOTHING, PHOTOGRAPH, ASSET)
        self.against = gui.add_dropdown("wipe against", choice, initial_value=choice[-1] if asset else NOTHING)
        self.share = gui.add_slider("wipe at", 0.0, 1.0, 0.01, 0.5)
        hint = "of the asset, about its upward axis; the model's own light stays"
        self.turn = gui.add_slider("turn the light [deg]", -180, 180, 5, 0, hint=hint, visible=asset is not None)

    def on_update(self, changed: Callable[[], None]) -> None:
        """Call `changed` whenever another picture is wanted."""
        for element in (self.against, self.share, self.turn):
            element.on_update(lambda event: changed())

    def over(self, picture: Picture, viewpoint: Viewpoint, rays: int) -> Picture:
        """The model's picture with the chosen one right of the wipe.

        Args:
            picture: (height, width, 3) from the viewpoint.
            rays: pixels for which the model was rendered; `picture` may have been enlarged since.
        """
        if self.against.value == NOTHING:
            return picture
        if self.against.value == ASSET and self._asset is not None:
            other = self._asset.picture(viewpoint, rays, np.deg2rad(self.turn.value))
            other = compose.enlarged(other, picture.shape[1])[: picture.shape[0]]
        else:
            other = self._photograph_from(viewpoint, picture)
        return compose.wiped(picture, other, self.share.value)

    def _photograph_from(self, viewpoint: Viewpoint, like: Picture) -> Picture:
        """The nearest training image warped to a viewpoint, of the size of another picture."""
        view = compose.nearest_view(viewpoint, self._views, self._reach)
        if self._photograph is None or self._photograph[0] != view.name:
            self._photograph = (view.name, view.read())
        height, width = like.shape[:2]
        camera = viewpoint.camera(width * height).scaled(width, height)
        return compose.warped(viewpoint, camera, view, self._photograph[1])


def lit_asset(asset: Path, light: Path) -> LitAsset:
    """The asset and light of two files. Raises KoalaError: one of them is no such file, or Mitsuba is missing."""
    require_mitsuba()
    images.read(light)
    return LitAsset(read(asset), light)
