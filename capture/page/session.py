"""A session on a page: arm, table, object, safety volume, views, and a time slider.

A trajectory is planned, so that each view shows whether the arm can take it. A recording shows the joint angles that the
controller reported. The arm is drawn with the nominal links of its model.
"""

from collections import Counter
from dataclasses import replace

import numpy as np
import viser
from numpy.typing import NDArray

from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.page.timeline import ShownView, Timeline
from koala3d.capture.planning import Obstacles
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.imaging import images
from koala3d.datasets.page import Page, PicturePanel, shapes
from koala3d.datasets.page.panel import bytes_of

ARM, CAMERA, TABLE, SAFETY, SOLID = (
    (170, 178, 190),
    (50, 50, 60),
    (205, 185, 160),
    (60, 160, 90),
    (190, 120, 90),
)  # colours of what is drawn, sRGB
FRUSTUM_M, THUMBNAIL = 0.05, 96  # length of the pyramids [m], and width of the pictures on them [px]
HALF_FIELD = 0.35  # tangent of half the field of view of the drawn pyramids: trajectory and recording do not know the lens
TICK_S = 0.05  # period of the playback
TABLE_M = 1.6


class CaptureView:
    """The contents of the page of one session."""

    def __init__(self, page: Page, trajectory: Trajectory, mount: Carrier, timeline: Timeline) -> None:
        self.page, self.trajectory, self.timeline = page, trajectory, timeline
        self.stops = {stop.name: stop for stop in timeline.stops}
        self.obstacles = Obstacles.of(trajectory, mount)
        self.frusta: dict[str, viser.CameraFrustumHandle] = {}
        self._parts: list[viser.MeshHandle] = []
        self._look()
        self._surroundings()
        self._views()
        self._panel()
        if len(timeline.seconds):
            self._arm()
            self.go(0.0)

    def _look(self) -> None:
        centre = np.array([0.3, 0.0, 0.2]) if self.trajectory.object is None else self.trajectory.object.corners.mean(0)
        up = self.trajectory.upwards
        self.page.look(np.add(centre, [0.9, -1.3, 0.8 * up]), centre * [0.6, 0.6, 1.0], up=(0, 0, up), size=1.0)

    def _surroundings(self) -> None:
        """Table, ceiling, object volume, safety volume, and the path of what the arm carries."""
        page, obstacles = self.page, self.obstacles
        for name, z, side in (("/table", obstacles.table_z, -obstacles.up), ("/ceiling", obstacles.ceiling_z, obstacles.up)):
            if z is not None:
                page.scene.add_box(name, TABLE, (TABLE_M, TABLE_M, 0.01), position=(0.3, 0, z + 0.006 * side), opacity=0.6)
        if obstacles.object_corners is not None:
            low, high = obstacles.object_corners
            shapes.add_box(page, "/object/edges", obstacles.object_corners, colour=shapes.COLOURS["box"])
            middle, size = (low + high) / 2, tuple(high - low)
            page.scene.add_box("/object/volume", shapes.COLOURS["box"], size, position=middle, opacity=0.15)
        for solid in obstacles.carrier.solids:
            page.scene.add_mesh_simple(f"/obstacles/{solid.name}", *solid.outline(), color=SOLID, opacity=0.6)
        if obstacles.workspace_corners is not None:
            shapes.add_box(page, "/safety", obstacles.workspace_corners, colour=SAFETY)
        if len(self.timeline.seconds) > 1:
            times = np.linspace(0, self.timeline.end, 12 * len(self.timeline.stops))
            joints = np.stack([self.timeline.at(when) for when in times])
            track = obstacles.carrier.base_from_carried(joints)[:, :3, 3]
            shapes.add_lines(page, "/path", np.stack([track[:-1], track[1:]], axis=1), colour=(150, 150, 150), thickness=1.0)

    def _views(self) -> None:
        settings = self.trajectory.camera
        focal = 0.5 * settings.width / HALF_FIELD
        camera = Camera(settings.width, settings.height, focal, focal, settings.width / 2, settings.height / 2)
        for stop in self.timeline.stops:
            meaning = stop.split if stop.seconds is not None else "blocked"
            name, colour = f"/views/{meaning}/{stop.name}", shapes.colour_of(meaning)
            handle = shapes.add_camera(self.page, name, stop.base_from_camera, camera, colour=colour, length=FRUSTUM_M)
            handle.on_click(lambda event, name=stop.name: self._chosen(event.client, self.stops[name]))
            self.frusta[stop.name] = handle

    def _panel(self) -> None:
        gui, stops = self.page.gui, self.timeline.stops
        counts = Counter(stop.split if stop.seconds is not None else "blocked" for stop in stops)
        notes = "  \n".join(self.timeline.notes)
        gui.add_markdown(f"**{self.trajectory.name}**\n\n{notes}\n\n{shapes.legend(counts)}")
        blocked = [f"- {stop.name}: {stop.reason}" for stop in stops if stop.reason]
        if blocked:
            with gui.add_folder("Cannot be taken", expand_by_default=len(blocked) < 6):
                gui.add_markdown("\n".join(blocked))
        if len(self.timeline.seconds):
            with gui.add_folder("Playback"):
                end = max(float(np.ceil(10 * self.timeline.end)) / 10, 0.1)
                self.slider = gui.add_slider("time [s]", 0.0, end, min(0.1, end), 0.0)
                self.slider.on_update(lambda event: self.go(event.target.value))
                self.play = gui.add_checkbox("play", False)
                self.speed = gui.add_slider("speed", 0.25, 20.0, 0.25, 4.0)
                self._angles = gui.add_markdown("")
            self.page.in_background(self._run)
        self.panel = PicturePanel(self.page, "View", "click a camera")

    def _arm(self) -> None:
        """Add one capsule along z for each part of the arm; `go` moves it into place."""
        ends = self.obstacles.carrier.segments(self.timeline.joints[0])
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1)
        for part, length in zip(self.obstacles.shape.parts, lengths, strict=True):
            vertices, faces = shapes.capsule([[0, 0, 0], [0, 0, length]], part.radius)
            colour = ARM if part.can_hide else CAMERA
            self._parts.append(self.page.scene.add_mesh_simple(f"/arm/{part.name}", vertices, faces, color=colour))

    def go(self, seconds: float) -> None:
        """Show the arm at a time [s], and its state as text."""
        joints = self.timeline.at(seconds)
        ends = self.obstacles.carrier.segments(joints)
        with self.page.server.atomic():
            for handle, (start, end) in zip(self._parts, ends, strict=True):
                handle.wxyz, handle.position = pose.quaternion(along_z(end - start)), start
        pair, room = self.obstacles.nearest(joints)
        following = self.timeline.next_stop(seconds)
        rows = "\n".join(f"| {number} | {angle:.1f} |" for number, angle in enumerate(np.degrees(joints), 1))
        self._angles.content = (
            f"{seconds:.1f} of {self.timeline.end:.1f} s, view {following.name if following else 'none'}  \n"
            f"closest: {pair}, {1e3 * (room + self.obstacles.clearance_m):.0f} mm\n\n| joint | degrees |\n|:---|:---|\n{rows}"
        )

    def _run(self) -> None:
        """Advance the slider while the playback runs, until the page ends."""
        while not self.page.stopping.wait(TICK_S):
            if self.play.value:
                later = self.slider.value + TICK_S * self.speed.value
                self.slider.value = later if later < self.timeline.end else 0.0

    def _chosen(self, client: viser.ClientHandle | None, stop: ShownView) -> None:
        """Move the arm to a view, and show the view in one browser."""
        if stop.seconds is not None:
            self.slider.value = stop.seconds
        if client is None:
            return
        position = ", ".join(f"{1e3 * value:.1f}" for value in stop.base_from_camera[:3, 3])
        state = f"cannot be taken: {stop.reason}" if stop.seconds is None else f"at {stop.seconds:.1f} s  \n{stop.measured}"
        words = f"**view {stop.name}** ({stop.split})  \ncamera at {position} mm  \n{state}"
        try:
            self.panel.show(client, words, None if stop.image is None else images.read(stop.image))
        except KoalaError as error:
            self.panel.show(client, f"{words}\n\n{error}", None)

    def taken(self, stop: ShownView) -> None:
        """Show the recorded data of a view: the picture on the camera, and the text on a click."""
        planned = self.stops[stop.name]
        self.stops[stop.name] = replace(stop, seconds=planned.seconds)
        if stop.image is not None:
            try:
                self.frusta[stop.name].image = bytes_of(images.read(stop.image), THUMBNAIL)
            except KoalaError:
                self.frusta[stop.name].color = shapes.COLOURS["error"]

    def add_thumbnails(self) -> None:
        """Show the pictures of a recording on its views, one after the other."""
        for stop in self.timeline.stops:
            if not self.page.stopping.is_set():
                self.taken(stop)


def along_z(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) rotation that turns z into a (3,) direction; the identity for a zero direction."""
    if np.linalg.norm(direction) < 1e-9:
        return np.eye(4)
    return pose.look_at((0, 0, 0), direction)
