"""Editor of camera paths on the page of a run, for 'reconstruct render --path'."""

import time
from pathlib import Path

import numpy as np
import viser
import yaml

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.core.schema import load_yaml
from koala3d.datasets.page import Page, shapes
from koala3d.reconstruct.output.camera_path import KeyPose, PathFile, frames_of
from koala3d.reconstruct.page.render_loop import viewpoint_of

COLOUR = (230, 120, 20)  # sRGB of the path
NONE: str = "none"  # the only entry of an empty list of stops
LEG_S, FPS = 2.0, 30.0  # time between two stops [s], and frames per second


class PathEditor:
    """Stops along a path, the curve through them, and their file."""

    def __init__(self, page: Page, out: Path, camera: Camera, reach: float) -> None:
        """Start with the path in `out`, if the file exists."""
        self.page, self.out, self.camera, self.reach = page, out, camera, reach
        self.stops: list[KeyPose] = []
        gui = page.gui
        with gui.add_folder("Path", expand_by_default=False):
            gui.add_button("add this view").on_click(lambda event: self.add(event.client))
            self.chosen = gui.add_dropdown("stop", (NONE,))
            gui.add_button("go to it").on_click(lambda event: self.go(event.client))
            gui.add_button("replace it with this view").on_click(lambda event: self.replace(event.client))
            gui.add_button("remove it").on_click(lambda event: self.remove())
            self.seconds = gui.add_number("seconds from stop to stop", LEG_S, min=0.1, max=60.0, step=0.1)
            self.closed = gui.add_checkbox("back to the first", False)
            gui.add_button("fly along it").on_click(lambda event: self._start(event.client))
            gui.add_button("write the path").on_click(lambda event: self.write())
            self._status = gui.add_markdown("*no stops yet*")
        self.closed.on_update(lambda event: self._draw())
        if out.is_file():
            self._read()

    def _read(self) -> None:
        """Load the path from the file."""
        try:
            before = load_yaml(self.out, PathFile)
        except KoalaError as error:
            self._status.content = str(error)
            return
        self.stops, self.closed.value = list(before.poses), before.closed
        self.seconds.value = before.seconds / max(len(before.poses) - (not before.closed), 1)
        self._draw(chosen=len(self.stops) - 1)

    @property
    def path(self) -> PathFile | None:
        """The path; None with fewer than two stops."""
        if len(self.stops) < 2:
            return None
        legs = len(self.stops) - (0 if self.closed.value else 1)
        return PathFile(fps=FPS, seconds=self.seconds.value * legs, closed=self.closed.value, poses=tuple(self.stops))

    @property
    def index(self) -> int | None:
        """Index of the selected stop; None without stops."""
        return int(self.chosen.value) - 1 if self.stops and self.chosen.value != NONE else None

    def _key_pose(self, client: viser.ClientHandle) -> KeyPose:
        matrix = viewpoint_of(client).world_from_camera.round(6)
        target = matrix[:3, 3] + self.reach * matrix[:3, 2]
        x, y, z = matrix[:3, 3].tolist(), target.round(6).tolist(), (-matrix[:3, 1]).tolist()
        return KeyPose(position=tuple(x), target=tuple(y), up=tuple(z))

    def add(self, client: viser.ClientHandle | None) -> None:
        """Insert a browser's viewpoint after the selected stop."""
        if client is None:
            return
        place = 0 if self.index is None else self.index + 1
        self.stops.insert(place, self._key_pose(client))
        self._draw(chosen=place)

    def replace(self, client: viser.ClientHandle | None) -> None:
        """Replace the selected stop by a browser's viewpoint."""
        if client is not None and self.index is not None:
            self.stops[self.index] = self._key_pose(client)
            self._draw()

    def remove(self) -> None:
        """Remove the selected stop."""
        if self.index is not None:
            place = self.index
            del self.stops[place]
            self._draw(chosen=max(place - 1, 0))

    def go(self, client: viser.ClientHandle | None) -> None:
        """Move a browser to the selected stop."""
        if client is not None and self.index is not None:
            stop = self.stops[self.index]
            shapes.look_through(client, pose.look_at(stop.position, stop.target, stop.up), self.camera, distance=self.reach)

    def _draw(self, chosen: int | None = None) -> None:
        """Draw the stops and the curve; `chosen` is the stop to select in the list."""
        self.page.scene.remove_by_name("/path")
        place = self.index if chosen is None else chosen
        self.chosen.options = tuple(str(number) for number in range(1, len(self.stops) + 1)) or (NONE,)
        self.chosen.value = str((place or 0) + 1) if self.stops else NONE
        self._status.content = self._count() if self.stops else "*no stops yet*"
        for index, stop in enumerate(self.stops):
            self.page.scene.add_icosphere(f"/path/stops/{index}", 0.012 * self.reach, COLOUR, position=stop.position)
        if self.path is None:
            return
        try:
            frames = frames_of(self.path)
        except KoalaError as error:
            self._status.content = f"{self._count()}; {error}"
            return
        places = np.stack([frame[:3, 3] for frame in frames])
        shapes.add_lines(self.page, "/path/curve", np.stack([places[:-1], places[1:]], axis=1), colour=COLOUR, thickness=2.0)

    def _count(self) -> str:
        return f"{len(self.stops)} {'stop' if len(self.stops) == 1 else 'stops'}"

    def _start(self, client: viser.ClientHandle | None) -> None:
        if client is not None and self.path is not None:
            self.page.in_background(lambda: self.fly(client))

    def fly(self, client: viser.ClientHandle) -> None:
        """Move a browser along the path as in the film."""
        if self.path is None:
            return
        frames, start, number = frames_of(self.path), time.monotonic(), 0
        while number < len(frames) - 1 and not self.page.stopping.wait(1 / FPS):
            number = min(int(FPS * (time.monotonic() - start)), len(frames) - 1)
            shapes.look_through(client, frames[number], self.camera, distance=self.reach)

    def write(self) -> None:
        """Write the path into the run's folder, replacing an earlier one."""
        if self.path is None:
            self._status.content = "*a path needs two stops*"
            return
        content = self.path.model_dump(mode="json")
        files.write_text(self.out, yaml.safe_dump(content, sort_keys=False, default_flow_style=None))
        self._status.content = f"{self._count()}, written to `{self.out}`"
