"""The editor of camera paths on the page of a run: it writes what 'reconstruct film --path' and 'render --path' read."""

import time
from pathlib import Path

import numpy as np
import viser
import yaml

from datasets import pose
from datasets.camera_model import Camera
from datasets.core import files
from datasets.core.errors import KoalaError
from datasets.core.schema import load_yaml
from datasets.page import Page, shapes
from reconstruct.output.camera_path import KeyPose, PathFile, frames_of
from reconstruct.page.render_loop import viewpoint_of

COLOUR = (230, 120, 20)
"""sRGB of the path."""
NONE = "none"
"""What the list of stops says while there are none."""
LEG_S, FPS = 2.0, 30.0
"""Time between two stops [s], and pictures per second, of the film."""


class PathEditor:
    """Stops that somebody adds by going there, the curve through them, and the file that they are written to."""

    def __init__(self, page: Page, out: Path, camera: Camera, reach: float) -> None:
        """Begin with the path in `out`, where there is one."""
        self.page, self.out, self.camera, self.reach = page, out, camera, reach
        self.stops: list[KeyPose] = []
        gui = page.gui
        with gui.add_folder("Path", expand_by_default=False):
            gui.add_button("add this view").on_click(lambda event: self.add(event.client))
            self.chosen = gui.add_dropdown("stop", (NONE,))
            gui.add_button("go to it").on_click(lambda event: self.go(event.client))
            gui.add_button("put this view in its place").on_click(lambda event: self.replace(event.client))
            gui.add_button("take it away").on_click(lambda event: self.remove())
            self.seconds = gui.add_number("seconds from stop to stop", LEG_S, min=0.1, max=60.0, step=0.1)
            self.closed = gui.add_checkbox("back to the first", False)
            gui.add_button("fly along it").on_click(lambda event: self._start(event.client))
            gui.add_button("write the path").on_click(lambda event: self.write())
            self._words = gui.add_markdown("*no stops yet*")
        self.closed.on_update(lambda event: self._draw())
        if out.is_file():
            self._read()

    def _read(self) -> None:
        """Take up the path that was written before."""
        try:
            before = load_yaml(self.out, PathFile)
        except KoalaError as error:
            self._words.content = str(error)
            return
        self.stops, self.closed.value = list(before.poses), before.closed
        self.seconds.value = before.seconds / max(len(before.poses) - (not before.closed), 1)
        self._draw(chosen=len(self.stops) - 1)

    @property
    def path(self) -> PathFile | None:
        """The path so far; None before its second stop."""
        if len(self.stops) < 2:
            return None
        legs = len(self.stops) - (0 if self.closed.value else 1)
        return PathFile(fps=FPS, seconds=self.seconds.value * legs, closed=self.closed.value, poses=tuple(self.stops))

    @property
    def index(self) -> int | None:
        """Of the stop that is chosen in the list; None before there is one."""
        return int(self.chosen.value) - 1 if self.stops and self.chosen.value != NONE else None

    def _seen_by(self, client: viser.ClientHandle) -> KeyPose:
        matrix = viewpoint_of(client).world_from_camera.round(6)
        target = matrix[:3, 3] + self.reach * matrix[:3, 2]
        x, y, z = matrix[:3, 3].tolist(), target.round(6).tolist(), (-matrix[:3, 1]).tolist()
        return KeyPose(position=tuple(x), target=tuple(y), up=tuple(z))

    def add(self, client: viser.ClientHandle | None) -> None:
        """Make where a browser looks from the next stop, after the one that is chosen."""
        if client is None:
            return
        place = 0 if self.index is None else self.index + 1
        self.stops.insert(place, self._seen_by(client))
        self._draw(chosen=place)

    def replace(self, client: viser.ClientHandle | None) -> None:
        """Put where a browser looks from in the place of the stop that is chosen."""
        if client is not None and self.index is not None:
            self.stops[self.index] = self._seen_by(client)
            self._draw()

    def remove(self) -> None:
        """Take the stop that is chosen away."""
        if self.index is not None:
            place = self.index
            del self.stops[place]
            self._draw(chosen=max(place - 1, 0))

    def go(self, client: viser.ClientHandle | None) -> None:
        """Take a browser to the stop that is chosen."""
        if client is not None and self.index is not None:
            stop = self.stops[self.index]
            shapes.look_through(client, pose.look_at(stop.position, stop.target, stop.up), self.camera, distance=self.reach)

    def _draw(self, chosen: int | None = None) -> None:
        """The stops, and the curve through them; `chosen` is the stop to choose in the list."""
        self.page.scene.remove_by_name("/path")
        place = self.index if chosen is None else chosen
        self.chosen.options = tuple(str(number) for number in range(1, len(self.stops) + 1)) or (NONE,)
        self.chosen.value = str((place or 0) + 1) if self.stops else NONE
        self._words.content = self._count() if self.stops else "*no stops yet*"
        for index, stop in enumerate(self.stops):
            self.page.scene.add_icosphere(f"/path/stops/{index}", 0.012 * self.reach, COLOUR, position=stop.position)
        if self.path is None:
            return
        try:
            frames = frames_of(self.path)
        except KoalaError as error:
            self._words.content = f"{self._count()}; {error}"
            return
        places = np.stack([frame[:3, 3] for frame in frames])
        shapes.add_lines(self.page, "/path/curve", np.stack([places[:-1], places[1:]], axis=1), colour=COLOUR, thickness=2.0)

    def _count(self) -> str:
        return f"{len(self.stops)} {'stop' if len(self.stops) == 1 else 'stops'}"

    def _start(self, client: viser.ClientHandle | None) -> None:
        if client is not None and self.path is not None:
            self.page.in_background(lambda: self.fly(client))

    def fly(self, client: viser.ClientHandle) -> None:
        """Take one browser along the path as the film will go, until its end or that of the page."""
        if self.path is None:
            return
        frames, start, number = frames_of(self.path), time.monotonic(), 0
        while number < len(frames) - 1 and not self.page.stopping.wait(1 / FPS):
            number = min(int(FPS * (time.monotonic() - start)), len(frames) - 1)
            shapes.look_through(client, frames[number], self.camera, distance=self.reach)

    def write(self) -> None:
        """Write the path beside the run, in place of the one before."""
        if self.path is None:
            self._words.content = "*a path needs two stops: add some first*"
            return
        content = self.path.model_dump(mode="json")
        files.write_text(self.out, yaml.safe_dump(content, sort_keys=False, default_flow_style=None))
        self._words.content = f"{self._count()}, written to `{self.out}`"
