"""The page of a run: explore the model during training and afterwards.

The newest checkpoint is rendered from each browser's viewpoint, first coarse, then finer while the camera rests. This process
renders; training runs in its own.
"""

import logging
import threading
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import viser
from viser import uplot

from koala3d.datasets.page import Page, PicturePanel, shapes
from koala3d.datasets.scene import View
from koala3d.datasets.structure import bounds
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.output.mesh import reading
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.page import compose
from koala3d.reconstruct.page.compose import Values, Viewpoint
from koala3d.reconstruct.page.path_editor import PathEditor
from koala3d.reconstruct.page.render_loop import LEVELS, Cancelled, RenderLoop, viewpoint_of
from koala3d.reconstruct.page.status import curves, is_training, skips_text, status_text
from koala3d.reconstruct.page.wipe import LitAsset, Wipe
from koala3d.reconstruct.rendering.pictures import taken
from koala3d.reconstruct.run import CHECKPOINTS, Run
from koala3d.reconstruct.training.pace.pause import PauseRequests

if TYPE_CHECKING:
    import trimesh

SLICE = 2048  # rays per call of the renderer, after which a picture can be cancelled; one compiled program serves all sizes
WIDTH = 640  # smallest width of the pictures that are sent; coarse ones are enlarged [px]
POLL_S = 1.0  # seconds between checks for a new checkpoint
MESH_RESOLUTION = 128
PATH = "path.yaml"  # file of the path editor in the run's folder
DEPTHS = (0.01, 50.0)  # camera distances [world unit] whose depths the browser resolves; its depth goes to 167 in steps of 1e-5
NOTHING = "nothing"  # channel that shows only cameras and mesh
logger = logging.getLogger(__name__)


class RunPage:
    """The page of one run."""

    def __init__(self, page: Page, run: Run, mesh: Path | None, asset: LitAsset | None = None) -> None:
        self.page, self.run, self.scene = page, run, run.scene()
        self.train_views = self.scene.split("train")
        self.trained: TrainedModel | None = None
        matrices = np.stack([view.world_from_camera for view in self.scene.views])
        centre, spread = bounds.focus(matrices)
        self.centre = centre if spread > bounds.PARALLEL else self.scene.box.mean(0)
        self.reach = max(float(np.median(np.linalg.norm(matrices[:, :3, 3] - self.centre, axis=1))), 1e-6)
        self._surface: viser.SceneNodeHandle | None = None
        self._sending = threading.Lock()
        """Held while a picture is sent or removed, so that none arrives after its channel was left."""
        self.pauses, self.training = PauseRequests(run.path), is_training(run)
        self.loop = RenderLoop(page, self._paint, moved=self._moved)
        first = self.train_views[0]
        self.page.look(first.world_from_camera[:3, 3], self.centre, up=shapes.upright(list(matrices)), size=self.reach)
        self._panel(asset)
        self._draw(mesh)

    def _panel(self, asset: LitAsset | None) -> None:
        gui = self.page.gui
        self._state = gui.add_markdown("*waiting for a checkpoint*")
        self.channel = gui.add_dropdown("channel", (*compose.CHANNELS, NOTHING))
        self.sharpest = gui.add_slider("sharpness", 1, len(LEVELS), 1, 4)
        hint = "a lower value leaves more time for training"
        self.sharpest_training = gui.add_slider("sharpness while it trains", 0, len(LEVELS), 1, 2, hint=hint)
        self.pace = gui.add_slider("training while I move [%]", 0, 100, 10, 30, hint="0 pauses it, 100 does not slow it down")
        for element in (self.channel, self.sharpest, self.sharpest_training):
            element.on_update(lambda event: self._changed())
        self.wipe = Wipe(gui, self.train_views, self.reach, asset)
        self.wipe.on_update(self._changed)
        gui.add_button("go to the nearest training view").on_click(lambda event: self._go(event.client))
        furthest, step = rounded_up(2 * self.reach)
        unit = " [m]" if self.scene.metric else ""
        self.cut = gui.add_slider(f"cut away nearer than{unit}", 0.0, furthest, step, 0.0)
        hint = "the maximum cuts nothing away"
        self.beyond = gui.add_slider(f"cut away beyond{unit}", 0.0, furthest, step, furthest, hint=hint)
        for element in (self.cut, self.beyond):
            element.on_update(lambda event: self._changed())
        self.cameras = gui.add_checkbox("cameras", True)
        self.cameras.on_update(lambda event: self._show_cameras(event.target.value))
        self.mesh = gui.add_checkbox("mesh", True, visible=False)
        self.mesh.on_update(lambda event: self._show_mesh(event.target.value))
        self._mesh_button = gui.add_button("extract the mesh")
        self._mesh_button.on_click(lambda event: self.page.in_background(self._extract))
        self.panel = PicturePanel(self.page, "Picture", "click a camera")
        self.editor = PathEditor(self.page, self.run.path / PATH, self.train_views[0].camera, self.reach)
        self._log_folder = gui.add_folder("Training")
        self._curve: viser.GuiUplotHandle | None = None
        with self._log_folder:
            self._log = gui.add_markdown("")
        with gui.add_folder("Skipped, and why", expand_by_default=False):
            self._skips = gui.add_markdown("*nothing recorded*")

    def _changed(self) -> None:
        self.loop.levels = self._levels()
        if self.channel.value == NOTHING:
            with self._sending:
                for client in self.page.server.get_clients().values():
                    client.scene.set_background_image(None)
        self.loop.restart()

    def _moved(self) -> None:
        """A browser's camera moves: slow a running training down as the slider says."""
        if self.training:
            self.pauses.request(self.pace.value / 100)

    def _levels(self) -> int:
        """Number of levels to render; a running training shares the processor."""
        if self.channel.value == NOTHING:
            return 0
        self.training = is_training(self.run)
        return min(self.sharpest.value, self.sharpest_training.value) if self.training else self.sharpest.value

    def _draw(self, mesh: Path | None) -> None:
        """Draw bounds, cameras and the given mesh."""
        shapes.add_box(self.page, "/bounds", self.scene.box, colour=shapes.COLOURS["box"])
        self._frusta = []
        for view in self.scene.views:
            name, colour = f"/cameras/{view.split}/{view.name}", shapes.colour_of(view.split)
            pose, length = view.world_from_camera, 0.08 * self.reach
            handle = shapes.add_camera(self.page, name, pose, view.camera, colour=colour, length=length)
            handle.on_click(lambda event, view=view: self._chosen(event.client, view))
            self._frusta.append(handle)
        if mesh is not None:
            self._add_mesh(reading.read(mesh))

    def _add_mesh(self, surface: "trimesh.Trimesh") -> None:
        """Show a surface in world coordinates, replacing an earlier one, and its checkbox."""
        self._surface = self.page.scene.add_mesh_trimesh("/mesh", surface)
        self.mesh.visible, self.mesh.value = True, True

    def _show_mesh(self, visible: bool) -> None:
        if self._surface is not None:
            self._surface.visible = visible

    def _show_cameras(self, visible: bool) -> None:
        for handle in self._frusta:
            handle.visible = visible

    def _chosen(self, client: viser.ClientHandle | None, view: View) -> None:
        if client is None:
            return
        shapes.look_through(client, view.world_from_camera, view.camera, distance=self.reach)
        self.panel.show(client, f"**view {view.name}** ({view.split})", view.read())

    def _go(self, client: viser.ClientHandle | None) -> None:
        if client is not None:
            self._chosen(client, compose.nearest_view(viewpoint_of(client), self.train_views, self.reach))

    def _extract(self) -> None:
        """Extract and show the surface of the current model."""
        from koala3d.reconstruct.output.mesh import extraction

        if self.trained is None:
            return
        self._mesh_button.disabled = True
        try:
            self._add_mesh(extraction.extract(self.trained, resolution=MESH_RESOLUTION))
        finally:
            self._mesh_button.disabled = False

    def render(self, viewpoint: Viewpoint, rays: int, *, normals: bool, cancelled: Cancelled = lambda: False) -> Values | None:
        """Render a viewpoint with about `rays` pixels: (height, width, channels) by the renderer's names.

        The page's cutting planes apply. Depth is in world units. None if it was cancelled or there is no model yet.
        """
        trained = self.trained
        if trained is None:
            return None
        camera, normalisation = viewpoint.camera(rays), trained.run.normalisation
        origins, directions, radii, light = trained.renderer.rays_of(viewpoint.view(camera), camera)
        cut = max(self.cut.value * normalisation.scale - normalisation.near, 0.0)
        origins += np.float32(cut) * directions  # rays start at the plane: their z is 1
        beyond = np.inf if self.beyond.value >= self.beyond.max else self.beyond.value * normalisation.scale - cut
        renderer, model = trained.renderer, trained.model
        parts: list[Values] = []
        for start in range(0, len(origins), SLICE):
            if cancelled():
                return None
            rows = np.minimum(np.arange(start, start + SLICE), len(origins) - 1)
            slices = taken((origins, directions, radii, light), rows)
            parts.append(renderer.rays(model, *slices, normals=normals, furthest=beyond))
        joined = {name: np.concatenate([part[name] for part in parts])[: len(origins)] for name in parts[0]}
        shaped = {name: value.reshape(camera.height, camera.width, -1) for name, value in joined.items()}
        depth = (shaped["depth"] + cut) * (shaped["depth"] > 0) / normalisation.scale
        shaped["depth"] = depth.astype(np.float32)
        return shaped

    def _paint(self, client: viser.ClientHandle, viewpoint: Viewpoint, rays: int, cancelled: Cancelled) -> None:
        channel = self.channel.value
        if channel == NOTHING:
            return
        values = self.render(viewpoint, rays, normals=compose.CHANNELS[channel] == compose.NORMALS, cancelled=cancelled)
        if values is None or cancelled():
            return
        picture = compose.enlarged(compose.picture_of(channel, values), WIDTH)
        picture = self.wipe.over(picture, viewpoint, rays)
        shown = (255 * picture + 0.5).astype(np.uint8)
        depth = compose.hiding_depth(values) if DEPTHS[0] < self.reach < DEPTHS[1] else None
        with self._sending:
            if self.channel.value == channel:
                client.scene.set_background_image(shown, format="jpeg", jpeg_quality=85, depth=depth)
        client.flush()

    def follow(self) -> None:
        """Load new checkpoints and update the curves until the page ends."""
        newest = None
        while not self.page.stopping.is_set():
            found = checkpoint.steps(self.run.path / CHECKPOINTS)
            if found and found[-1] != newest and self._take():
                newest = found[-1]
                self._changed()
            elif self.loop.levels != self._levels():
                self._changed()  # the training has stopped or resumed
            self._update_status()
            self.page.stopping.wait(POLL_S)

    def _take(self) -> bool:
        """Load the newest checkpoint. False if it was deleted meanwhile: a running training keeps the last two."""
        try:
            if self.trained is None:
                self.trained = TrainedModel.open(self.run.path)
            else:
                model, step = checkpoint.load_model(self.run.path / CHECKPOINTS, self.trained.model)
                self.trained = replace(self.trained, model=model, step=step)
        except (OSError, ReconstructError) as error:
            logger.info("checkpoint not taken: %s", error)
            return False
        return True

    def _update_status(self) -> None:
        """Update step, status, curves and skips."""
        log = self.run.log()
        if self.trained is not None:
            self._state.content = f"**{self.scene.name}**, {self.run.config.model}, step {self.trained.step}"
        self._skips.content = skips_text(self.run) or "*nothing recorded*"
        text = status_text(log, self.run)
        if text == self._log.content:
            return
        self._log.content = text
        if len(log) < 2:
            return
        data, series = curves(log)
        if self._curve is None:
            with self._log_folder:
                self._curve = self.page.gui.add_uplot(data, series, scales={"x": uplot.Scale(time=False)}, aspect=1.6)
        else:
            self._curve.data = data


def rounded_up(length: float) -> tuple[float, float]:
    """A length rounded up to two digits for a slider, and a step of a hundredth to a thousandth of it."""
    step = 10.0 ** np.floor(np.log10(length) - 2)
    return float(np.ceil(length / (10 * step)) * 10 * step), float(step)


def show(page: Page, run: Run, *, mesh: Path | None = None, asset: LitAsset | None = None) -> RunPage:
    """Show a run on a page; the model appears once it is loaded.

    Args:
        run: finished, or trained by another process.
        mesh: file of a mesh in world coordinates to overlay.
        asset: of the run, to be wiped against the model.
    """
    shown = RunPage(page, run, mesh, asset)
    page.in_background(shown.follow)
    page.in_background(shown.loop.run)
    return shown
