"""The page of a scene: cameras by split with their images, points, bounds, and the findings of `datasets check` in place.

The page opens at once; thumbnails and findings follow when they are ready.
"""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import viser

from koala3d.datasets.checks.check import check, summary
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.core.findings import Finding
from koala3d.datasets.imaging import images
from koala3d.datasets.page import Page, PicturePanel, shapes
from koala3d.datasets.page.panel import bytes_of
from koala3d.datasets.page.ruler import Ruler
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.structure import bounds

THUMBNAIL = 96  # width of the images on the cameras [px]
MOST_POINTS = 200_000  # largest number of points shown; larger clouds are thinned


class _Stopped(Exception):
    """The page was closed during a check."""


class SceneView:
    """The content of the page of one scene."""

    def __init__(self, page: Page, scene: Scene) -> None:
        self.page, self.scene = page, scene
        matrices = np.stack([view.world_from_camera for view in scene.views])
        self.up = shapes.upright(list(matrices))
        self.centre = bounds.middle(matrices, scene.box)
        self.reach = max(float(np.median(np.linalg.norm(matrices[:, :3, 3] - self.centre, axis=1))), 1e-6)
        """Median distance of the cameras from their focus [world unit]."""
        self.cameras: dict[str, viser.CameraFrustumHandle] = {}
        self._look()
        self._overview()
        self.panel = PicturePanel(page, "Picture", "click a camera, or choose a view above")
        self.ruler = Ruler(page, scene, 0.02 * self.reach) if scene.points is not None and len(scene.points) else None
        self._findings = page.gui.add_markdown("")
        self._draw()

    def _look(self) -> None:
        aside = np.cross(self.up, [0.0, 1.0, 0.0] if abs(self.up[1]) < 0.9 else [1.0, 0.0, 0.0])
        position = self.centre + self.reach * (1.9 * aside / np.linalg.norm(aside) + 1.1 * self.up)
        self.page.look(position, self.centre, up=self.up, size=self.reach)

    def _overview(self) -> None:
        """Add a legend, switches for what is shown, and a list of views."""
        gui, counts = self.page.gui, Counter(view.split for view in self.scene.views)
        gui.add_markdown(f"**{self.scene.name}** ({self.scene.provenance.get('format', 'koala')})\n\n{shapes.legend(counts)}")
        shown = {"cameras": self._show_cameras, "bounds": self._show("/bounds")}
        if self.scene.points is not None and len(self.scene.points):
            shown["points"] = self._show("/points")
        with gui.add_folder("Show"):
            for name, change in shown.items():
                gui.add_checkbox(name, True).on_update(lambda event, change=change: change(event.target.value))
            size = gui.add_slider("camera size", 0.02, 0.5, 0.01, 0.12)
            size.on_update(lambda event: self._resize(event.target.value))
        names = tuple(view.name for view in self.scene.views)
        chosen = gui.add_dropdown("view", names)
        chosen.on_update(lambda event: self._chosen(event.client, event.target.value))
        gui.add_button("look through it").on_click(lambda event: self._enter(event.client, chosen.value))

    def _show(self, name: str) -> Any:
        def change(visible: bool) -> None:
            handle = self.page.scene.get_handle_by_name(name)
            if handle is not None:
                handle.visible = visible

        return change

    def _show_cameras(self, visible: bool) -> None:
        for handle in self.cameras.values():
            handle.visible = visible

    def _resize(self, share: float) -> None:
        for handle in self.cameras.values():
            handle.scale = share * self.reach / 2

    def _draw(self) -> None:
        scene, page = self.scene, self.page
        shapes.add_box(page, "/bounds", scene.box, colour=shapes.COLOURS["box"])
        if scene.points is not None and len(scene.points):
            step = -(-len(scene.points) // MOST_POINTS)
            colours = (90, 90, 90) if scene.colours is None else scene.colours[::step]
            page.scene.add_point_cloud(
                "/points", scene.points[::step].astype(np.float32), colours, point_size=0.004 * self.reach, precision="float32"
            )
        for view in scene.views:
            name, colour = f"/cameras/{view.split}/{view.name}", shapes.colour_of(view.split)
            length = 0.12 * self.reach
            handle = shapes.add_camera(page, name, view.world_from_camera, view.camera, colour=colour, length=length)
            handle.on_click(lambda event, view=view: self._chosen(event.client, view.name))
            self.cameras[view.name] = handle

    def _chosen(self, client: viser.ClientHandle | None, name: str) -> None:
        """Show the image of a view in one browser."""
        if client is None:
            return
        view = next(view for view in self.scene.views if view.name == name)
        try:
            self.panel.show(client, caption(view, metric=self.scene.metric), view.read())
        except KoalaError as error:
            client.add_notification(f"view {name}", str(error), color="red")

    def _enter(self, client: viser.ClientHandle | None, name: str) -> None:
        if client is not None:
            view = next(view for view in self.scene.views if view.name == name)
            shapes.look_through(client, view.world_from_camera, view.camera, distance=self.reach)
            self._chosen(client, name)

    def add_thumbnails(self) -> None:
        """Put each view's image on its camera; the cameras of unreadable views become red."""
        for view in self.scene.views:
            if self.page.stopping.is_set():
                return
            try:
                self.cameras[view.name].image = thumbnail(view)
            except KoalaError:
                self.cameras[view.name].color = shapes.COLOURS["error"]

    def add_findings(self, path: str | Path, *, matches: bool, **options: Any) -> list[Finding]:
        """Check the scene and mark each finding in place; arguments as of `check`. Empty where the page was closed before."""

        def done(count: int, total: int) -> None:
            self._findings.content = f"*checking: {count} of {total} views*"
            if self.page.stopping.is_set():
                raise _Stopped

        try:
            findings = check(path, matches=matches, done=done, **options)
        except _Stopped:
            return []
        for index, finding in enumerate(findings):
            self._mark(index, finding)
        lines = "\n".join(f"- {finding.line}" for finding in findings)
        self._findings.content = f"**Findings of 'datasets check'**\n\n{lines or 'nothing is wrong'}"
        return findings

    def _mark(self, index: int, finding: Finding) -> None:
        """Mark the cameras that a finding is about, or the space above the box where it is about the whole scene."""
        colour, words, size = shapes.colour_of(finding.level), f"{finding.level}: {finding.what}", 0.02 * self.reach
        concerned = views_of(finding, self.scene)
        for view in concerned:
            name, place = f"/findings/{index}/{view.name}", view.world_from_camera[:3, 3]
            shapes.add_mark(self.page, name, words, place, colour=colour, size=size)
            self.cameras[view.name].color = colour
        if not concerned:
            above = self.scene.box.mean(0) + self.up * (0.6 * np.ptp(self.scene.box, axis=0).max() + 0.06 * index * self.reach)
            shapes.add_mark(self.page, f"/findings/{index}/scene", words, above, colour=colour, size=size)


def views_of(finding: Finding, scene: Scene) -> list[View]:
    """The views that a finding names, directly or by one of their files; none where it is about the scene."""
    where = finding.where
    named = [view for view in scene.views if where in (f"view {view.name}", f"camera of view {view.name}")]
    if named:
        return named
    return [v for v in scene.views if f"(view {v.name})" in where or where in map(str, (v.image, v.mask, *v.truth.values()))]


def thumbnail(view: View) -> np.ndarray:
    """(h, w, 3) bytes of a view's image, `THUMBNAIL` pixels wide. Raises as `View.read` does."""
    height = max(1, round(THUMBNAIL * view.camera.height / view.camera.width))
    return bytes_of(images.resize(view.read(), THUMBNAIL, height), THUMBNAIL)


def caption(view: View, *, metric: bool) -> str:
    """Markdown about one view; `metric` for positions in metres."""
    camera, position = view.camera, ", ".join(f"{value:.4g}" for value in view.world_from_camera[:3, 3])
    lens = "pinhole" if camera.is_pinhole else "fisheye" if camera.fisheye else "distorted"
    truth = f"  \ntruth: {', '.join(sorted(view.truth))}" if view.truth else ""
    return (
        f"**view {view.name}** ({view.split})  \n`{view.image.name}`, {camera.width} x {camera.height} px, {lens}  \n"
        f"fx {camera.fx:.1f}, fy {camera.fy:.1f}, cx {camera.cx:.1f}, cy {camera.cy:.1f} px  \n"
        f"at {position}{' m' if metric else ''}{truth}"
    )


def show(page: Page, path: str | Path, scene: Scene, *, quick: bool = False, **options: Any) -> SceneView:
    """Show a scene on a page; thumbnails and findings follow in the background.

    Args:
        path: of the scene, for the check.
        quick: do not match features between views.
        **options: of `load_scene`.
    """
    shown = SceneView(page, scene)

    def rest() -> None:
        shown.add_thumbnails()
        if not page.stopping.is_set():
            shown.add_findings(path, matches=not quick, **options)

    page.in_background(rest)
    return shown


def describe(scene: Scene) -> dict[str, Any]:
    """The figures of a scene that `datasets view` prints."""
    return {key: value for key, value in summary(scene).items() if key in ("name", "views", "sizes", "points", "notes")}
