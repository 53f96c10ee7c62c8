"""A training for Rerun's viewer: the scene's cameras with their pictures, curves of the log, and the surface as it grows.

`step` counts the steps of the training.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from koala3d.datasets.formats.links import file_name
from koala3d.datasets.reports.rerun_file import RerunFile, rerun_file
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.output.mesh.extraction import extract
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.rendering.model import Model

if TYPE_CHECKING:
    from koala3d.reconstruct.training.training import Training

BOX = (190, 150, 30)  # sRGB
RESOLUTION = 64  # grid points along the longest side of the box
EVERY = 5
"""A mesh is taken at every fifth line of the log, which has forty, and at the last."""


class RerunTraining:
    """Adds each line of the log, and the surface, to a file while a training runs."""

    def __init__(self, shown: RerunFile, scene: Scene) -> None:
        self.shown, self.scene, self.lines = shown, scene, 0
        shown.box("world/box", scene.box, BOX)
        for view in scene.views:
            entity = f"world/{view.split}/{file_name(view)}"
            shown.frame(entity, view.world_from_camera, always=True)
            shown.camera(entity, view.camera, length_m=float(np.ptp(scene.box, axis=0).max()) / 4)
            shown.picture(entity, view.image, view.camera, always=True)

    def __call__(self, training: "Training", model: Model, line: dict[str, Any]) -> None:
        """One line of the log, as it is written."""
        self.shown.at(step=line["step"])
        self.shown.numbers("figures", {name: float(line[name]) for name in ("psnr_train", "psnr_unseen") if name in line})
        self.shown.numbers("loss", line.get("terms", {}))
        self.lines += 1
        if self.lines % EVERY == 0 or line["progress"] >= 1:
            self.surface(TrainedModel(training.run, self.scene, model, line["step"], training.renderer))

    def surface(self, trained: TrainedModel) -> None:
        """The surface of the model, if it has one yet."""
        try:
            mesh = extract(trained, resolution=RESOLUTION)
        except ReconstructError:
            return  # nothing is solid yet
        colours: Any = mesh.visual
        self.shown.mesh("world/surface", mesh.vertices, mesh.faces, colours=colours.vertex_colors, normals=mesh.vertex_normals)


@contextmanager
def watcher(out: Path | None, scene: Scene) -> Iterator[RerunTraining | None]:
    """What a training calls with each line of its log; None where nobody wants a file."""
    if out is None:
        yield None
        return
    with rerun_file(out, scene.name) as shown:
        yield RerunTraining(shown, scene)
