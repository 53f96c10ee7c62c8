"""A trained model ready for use: the run, its scene, its newest checkpoint and a renderer."""

from dataclasses import dataclass
from pathlib import Path

import jax

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.scene import Scene, View
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.rendering.pictures import Picture, Renderer
from koala3d.reconstruct.run import CHECKPOINTS, Run
from koala3d.reconstruct.scene import poses
from koala3d.reconstruct.scene.rays import scaled_camera


@dataclass(frozen=True)
class TrainedModel:
    """The newest state of a run."""

    run: Run
    scene: Scene  # with refined poses of the training views, if the run refined them
    model: Model
    step: int  # steps of the training
    renderer: Renderer

    @classmethod
    def open(cls, path: Path) -> "TrainedModel":
        """Load the newest checkpoint of a run.

        Raises:
            UsageError: `path` is not a run, or its scene is missing.
            ReconstructError: it has no checkpoint yet.
        """
        run = Run.open(path)
        scene = run.scene()
        model, step = checkpoint.load_model(run.path / CHECKPOINTS, Model.create(jax.random.key(0), run.config, run.facts))
        scene = poses.refined(scene, run.normalisation, model.poses, model.session)
        return cls(run, scene, model, step, Renderer(run.normalisation, light=run.facts.light))

    def camera(self, view: View) -> Camera:
        """A view's camera at the scale of the training."""
        return scaled_camera(view, self.run.config.scale)

    def picture(self, view: View) -> Picture:
        """Render all channels of a view at the scale of the training."""
        return self.renderer.picture(self.model, view, self.camera(view))

    def warm_up(self, view: View) -> None:
        """Compile what `picture` needs for views of this size."""
        self.renderer.warm_up(self.model, self.renderer.rays_of(view, self.camera(view)))
