"""A ruler on the page of a scene: the distance between two clicked points, and the option that makes it a known length."""

import shlex

import numpy as np
import viser
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets.page import shapes
from koala3d.datasets.page.server import Page
from koala3d.datasets.scene import Scene

WIDEST = np.deg2rad(3.0)
"""Largest angle between a click and the point that it is taken for."""
BEHIND = np.deg2rad(0.5)
"""Of points that are this near to each other on the screen, the one in front is taken."""
COLOUR = (230, 120, 0)


class Ruler:
    """Measures between surface points of a scene, the same for all browsers."""

    def __init__(self, page: Page, scene: Scene, size: float) -> None:
        self.page, self.scene, self.size = page, scene, size
        """`size` is that of the marks [world unit]."""
        self.ends: list[int] = []
        """The points that were clicked, two at most."""
        with page.gui.add_folder("Ruler"):
            active = page.gui.add_checkbox("measure", False)
            self._words = page.gui.add_markdown("")
        active.on_update(lambda event: self.switch(event.target.value))

    def switch(self, on: bool) -> None:
        """Begin to listen to clicks, or stop and remove the marks."""
        self.ends = []
        if on:
            self.page.scene.on_click()(self._clicked)
        else:
            self.page.scene.remove_click_callback(self._clicked)
        self._draw()
        self._words.content = "*click two points*" if on else ""

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        self.click(event.ray_origin, event.ray_direction)

    def click(self, origin: ArrayLike, direction: ArrayLike) -> None:
        """Take the point along a ray as the next end; a third click begins anew."""
        assert self.scene.points is not None
        chosen = along_ray(self.scene.points, origin, direction)
        if chosen is not None:
            self.ends = [*self.ends, chosen] if len(self.ends) < 2 else [chosen]
            self._draw()
            self._words.content = self.words()

    def words(self) -> str:
        """Markdown on the distance, and how to make it a known length."""
        if len(self.ends) < 2 or self.scene.points is None:
            return "*click another point*"
        distance = float(np.linalg.norm(np.subtract(*self.scene.points[self.ends])))
        unit = "m" if self.scene.metric else "units"
        places = [sighted(self.scene, end) for end in self.ends]
        if None in places:
            return f"**{distance:.4g} {unit}**"
        command = f"datasets edit SCENE --known-length {' '.join(shlex.quote(str(place)) for place in places)} METRES --out NEW"
        return f"**{distance:.4g} {unit}**\n\nWith its true length in metres:\n\n```\n{command}\n```"

    def _draw(self) -> None:
        for name in ("A/ball", "A/words", "B/ball", "B/words"):
            if (handle := self.page.scene.get_handle_by_name(f"/ruler/{name}")) is not None:
                handle.remove()
        for name, end in zip("AB", self.ends, strict=False):
            if self.scene.points is not None:
                shapes.add_mark(self.page, f"/ruler/{name}", name, self.scene.points[end], colour=COLOUR, size=self.size)


def along_ray(points: NDArray[np.float64], origin: ArrayLike, direction: ArrayLike) -> int | None:
    """Index of the (n, 3) point that a (3,) ray meets: the nearest of those around it; None where there is none."""
    direction = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    local = points - np.asarray(origin, np.float64)
    depth = local @ direction
    angle = np.arctan2(np.linalg.norm(local - depth[:, None] * direction, axis=1), depth)
    if not len(points) or angle.min() > WIDEST:
        return None
    near = np.flatnonzero(angle <= angle.min() + BEHIND)
    return int(near[depth[near].argmin()])


def sighted(scene: Scene, point: int) -> str | None:
    """A point as `--known-length` takes it: its pixel in the two views furthest apart that saw it; None where fewer did."""
    if scene.sightings is None:
        return None
    rows = np.flatnonzero(scene.sightings.index[:, 0] == point)
    views = {view.name: view for view in scene.views}
    seen = [(scene.sightings.names[scene.sightings.index[row, 1]], row) for row in rows]
    seen = [(name, row) for name, row in seen if name in views]
    if len(seen) < 2:
        return None
    places = np.stack([views[name].world_from_camera[:3, 3] for name, _ in seen])
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    ends = np.unravel_index(apart.argmax(), apart.shape)
    pixels = [(seen[k][0], scene.sightings.pixels[seen[k][1]]) for k in ends]
    return "+".join(f"{name}:{x:.1f},{y:.1f}" for name, (x, y) in pixels)
