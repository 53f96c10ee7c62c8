"""The editor of camera paths on the page of a run: it writes what 'reconstruct film --path' reads."""

import time
from pathlib import Path

import numpy as np
import viser
import yaml

from datasets import files
from datasets.camera_model import Camera
from datasets.errors import KoalaError
from datasets.viewer import Page, shapes
from reconstruct.camera_path import KeyPose, PathFile, frames_of
from reconstruct.view_eyes import eye_of

COLOUR = (230, 120, 20)
"""sRGB of the path."""
LEG_S, FPS = 2.0, 30.0
"""Time between two stops [s], and pictures per second, of the film."""


class PathEditor:
    """Stops that somebody adds by going there, the curve through them, and the file that they are written to."""

    def __init__(self, page: Page, out: Path, camera: Camera, reach: float) -> None:
        self.page, self.out, self.camera, self.reach = page, out, camera, reach
        self.stops: list[KeyPose] = []
        gui = page.gui
        with gui.add_folder("Path", expand_by_default=False):
            gui.add_button("add this view").on_click(lambda event: self.add(event.client))
            gui.add_button("take the last one away").on_click(lambda event: self.remove())
            gui.add_button("fly along it").on_click(lambda event: self._start(event.client))
            gui.add_button("write the path").on_click(lambda event: self.write())
            self._words = gui.add_markdown("*no stops yet*")

    @property
    def path(self) -> PathFile | None:
        """The path so far; None before its second stop."""
        if len(self.stops) < 2:
            return None
        return PathFile(fps=FPS, seconds=LEG_S * (len(self.stops) - 1), closed=False, poses=tuple(self.stops))

    def add(self, client: viser.ClientHandle | None) -> None:
        """Make where a browser looks from the next stop."""
        if client is None:
            return
        matrix = eye_of(client).world_from_camera.round(6)
        target = matrix[:3, 3] + self.reach * matrix[:3, 2]
        x, y, z = matrix[:3, 3].tolist(), target.round(6).tolist(), (-matrix[:3, 1]).tolist()
        self.stops.append(KeyPose(position=tuple(x), target=tuple(y), up=tuple(z)))
        self._draw()

    def remove(self) -> None:
        """Take the last stop away."""
        del self.stops[-1:]
        self._draw()

    def _draw(self) -> None:
        """The stops, and the curve through them."""
        self.page.scene.remove_by_name("/path")
        self._words.content = f"{len(self.stops)} stops" if self.stops else "*no stops yet*"
        for index, stop in enumerate(self.stops):
            self.page.scene.add_icosphere(f"/path/stops/{index}", 0.012 * self.reach, COLOUR, position=stop.position)
        if self.path is None:
            return
        try:
            frames = frames_of(self.path)
        except KoalaError as error:
            self._words.content = f"{len(self.stops)} stops; {error}"
            return
        places = np.stack([frame[:3, 3] for frame in frames])
        shapes.add_lines(self.page, "/path/curve", np.stack([places[:-1], places[1:]], axis=1), colour=COLOUR, thickness=2.0)

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
        self._words.content = f"{len(self.stops)} stops, written to `{self.out}`"
