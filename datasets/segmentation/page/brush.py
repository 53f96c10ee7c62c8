"""The page on which masks are looked at and corrected: a picture, a brush, and a button that cuts all views again."""

import threading
from pathlib import Path

import numpy as np
import viser
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets.core.progress import ignore
from koala3d.datasets.formats.links import Extra
from koala3d.datasets.page import shapes
from koala3d.datasets.page.server import Page
from koala3d.datasets.segmentation.grow import Grower, Grown
from koala3d.datasets.segmentation.strokes import Stroke
from koala3d.datasets.segmentation.write import write

DIMMED = 0.3
"""Brightness of what is not the object."""
COLOURS = {"object": (0, 200, 0), "background": (220, 0, 0)}


class MaskPage:
    """The content of the page: one view at a time, seen from its own camera."""

    def __init__(self, page: Page, grower: Grower, found: Grown, strokes: list[Stroke], out: Path, extra: Extra = None) -> None:
        self.page, self.grower, self.found, self.strokes = page, grower, found, list(strokes)
        self.out, self.extra = out, extra
        self.chosen = int(found.agreement.argmin())
        self._busy = threading.Lock()
        gui = page.gui
        names = tuple(view.name for view in grower.views)
        self._view = gui.add_dropdown("view", names, initial_value=names[self.chosen])
        self._of = gui.add_dropdown("brush", ("object", "background"))
        self._radius = gui.add_slider("radius [% of the width]", 0.5, 10.0, 0.5, 2.0)
        self._words = gui.add_markdown("")
        self._view.on_update(lambda _: self.show(names.index(self._view.value)))
        gui.add_button("undo").on_click(lambda _: self.undo())
        gui.add_button("cut all views again").on_click(lambda _: page.in_background(self.cut))
        gui.add_button("write the scene").on_click(lambda _: page.in_background(self.write))
        page.server.on_client_connect(self._enter)
        page.scene.on_click()(lambda event: self.click(event.ray_origin, event.ray_direction))
        view = grower.views[self.chosen]
        page.look(view.world_from_camera[:3, 3], grower.ball.centre, up=-view.world_from_camera[:3, 1], size=grower.ball.radius)
        self.show(self.chosen)

    def show(self, view: int) -> None:
        """Show a view, and look at it from its camera."""
        self.chosen = view
        self._draw()
        for client in self.page.server.get_clients().values():
            self._enter(client)

    def click(self, origin: ArrayLike, direction: ArrayLike) -> None:
        """Add a dot of the brush where a ray in the world meets the picture."""
        at = self.pixel(origin, direction)
        if at is None:
            return
        view = self.grower.views[self.chosen]
        radius = self._radius.value / 100 * view.camera.width
        self.strokes.append(Stroke(view=view.name, of=self._of.value, points=[at], radius=radius))
        self._draw()

    def pixel(self, origin: ArrayLike, direction: ArrayLike) -> tuple[float, float] | None:
        """Where a ray meets the shown picture; None outside."""
        view = self.grower.views[self.chosen]
        rotation = view.world_from_camera[:3, :3]
        start = (np.asarray(origin, np.float64) - view.world_from_camera[:3, 3]) @ rotation
        along = np.asarray(direction, np.float64) @ rotation
        if abs(along[2]) < 1e-9:
            return None
        distance = (self.depth - start[2]) / along[2]
        x, y = view.camera.undistorted().project(start + distance * along)
        inside = distance > 0 and 0 <= x < view.camera.width and 0 <= y < view.camera.height
        return (float(x), float(y)) if inside else None

    @property
    def depth(self) -> float:
        """Distance of the shown picture from its camera [world unit]."""
        return 0.5 * self.grower.ball.radius

    def undo(self) -> None:
        """Take the last dot back."""
        self.strokes = self.strokes[:-1]
        self._draw()

    def cut(self) -> None:
        """Cut all views again with the strokes so far."""
        with self._busy:
            self._words.content = "*cutting ...*"
            self.found = self.grower.grow(self.strokes, done=ignore)
            self._draw()

    def write(self) -> None:
        """Write the scene with the masks that were cut last."""
        with self._busy:
            write(self.grower.scene, self.found.masks, self.strokes, self.out, extra=self.extra)
            self._words.content = f"written to `{self.out}`"

    def picture(self) -> NDArray[np.uint8]:
        """(height, width, 3) the shown picture, dark outside the mask, with strokes in colour."""
        view, small = self.grower.views[self.chosen], self.grower.pictures[self.chosen]
        mask = self.found.masks[self.chosen]
        shown = np.where(mask[..., None], small, small * DIMMED).astype(np.uint8)
        for stroke in self.strokes:
            if stroke.view == view.name:
                shown[stroke.painted(view.camera, mask.shape)] = COLOURS[stroke.of]
        return shown

    def _draw(self) -> None:
        view = self.grower.views[self.chosen]
        camera = view.camera
        middle = self.depth * np.array(
            [(camera.width / 2 - camera.cx) / camera.fx, (camera.height / 2 - camera.cy) / camera.fy, 1]
        )
        size = self.depth * camera.width / camera.fx, self.depth * camera.height / camera.fy
        rotation, position = shapes.placed(view.world_from_camera)
        place = view.world_from_camera[:3, :3] @ middle + position
        self.page.scene.add_image("/picture", self.picture(), *size, format="png", wxyz=rotation, position=place)
        share = self.found.agreement[self.chosen]
        count = len(self.strokes)
        self._words.content = f"agrees by {share:.0%} with the other views; {count} dot{'' if count == 1 else 's'} of the brush"

    def _enter(self, client: viser.ClientHandle) -> None:
        view = self.grower.views[self.chosen]
        shapes.look_through(client, view.world_from_camera, view.camera, distance=self.depth)
