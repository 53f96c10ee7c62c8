"""Koala as NerfBaselines calls a method: one step of the training at a time, a checkpoint, pictures.

A checkpoint is a run of Koala without its scene, which rendering does not need.
"""

import shutil
import tempfile
from pathlib import Path
from typing import Any

import jax
import numpy as np

from koala3d.datasets.scene import View
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.benchmark.dataset import MODELS, camera_of, scene_of
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.rendering.pictures import Renderer
from koala3d.reconstruct.run import CHECKPOINTS, Run
from koala3d.reconstruct.training.beginning.starting import start
from koala3d.reconstruct.training.training import Training

ABOUT = {
    "method_id": "",  # NerfBaselines puts it in
    "required_features": frozenset(("color",)),
    "supported_camera_models": frozenset(MODELS),
    "supported_outputs": ("color", "depth", "accumulation"),
    "can_resume_training": False,
}


class Koala:
    """A method of NerfBaselines, by its protocol `nerfbaselines.Method`.

    Overrides are settings of Koala by name (`train.steps`), and `model` and `preset`. Backgrounds and bounds are found out as in
    `reconstruct train`; pictures are trained on at their full size.
    """

    def __init__(
        self,
        *,
        checkpoint: str | None = None,
        train_dataset: Any = None,
        config_overrides: dict[str, Any] | None = None,
    ) -> None:
        """Begin a training on a loaded dataset, or load a checkpoint, with which datasets and overrides mean nothing."""
        self._training: Training | None = None
        self._source = checkpoint
        if checkpoint is not None:
            self._run = Run.open(Path(checkpoint))
            self._renderer = Renderer(self._run.normalisation, light=self._run.facts.light)
            self._model, self._loaded = _stored(self._run)
            return
        if train_dataset is None:
            raise ValueError("neither a checkpoint nor a dataset to train on is given")
        self._work = tempfile.TemporaryDirectory(prefix="koala-nerfbaselines-")
        folder, given = Path(self._work.name), {"scale": 1.0, **(config_overrides or {})}
        model, preset = given.pop("model", "surfnerf"), given.pop("preset", "fast")
        config = load_config(model, preset, [f"{key}={value}" for key, value in given.items()])
        self._training = start(scene_of(train_dataset, folder / "scene"), folder / "scene", config, folder / "run")
        self._training.compile()
        self._run, self._renderer, self._loaded = self._training.run, self._training.renderer, None

    @classmethod
    def get_method_info(cls) -> dict[str, Any]:
        """What data the method needs, and what it renders."""
        return dict(ABOUT)

    def get_info(self) -> dict[str, Any]:
        """The same, with the length of the training and the checkpoint that was loaded."""
        state = {"num_iterations": self._run.config.train.steps, "loaded_step": self._loaded, "loaded_checkpoint": self._source}
        return {**ABOUT, **state, "hparams": {"model": self._run.config.model, "preset": self._run.config.preset}}

    def train_iteration(self, step: int) -> dict[str, float]:
        """One step; its losses, and the PSNR [dB] of its rays."""
        if self._training is None:
            raise RuntimeError("a loaded checkpoint is not trained on: begin with a dataset")
        terms = {name: float(value) for name, value in self._training.chunk(most=1).items()}
        return terms | ({"psnr": -10 * float(np.log10(max(terms["mse"], 1e-10)))} if "mse" in terms else {})

    def save(self, path: str) -> None:
        """Write a checkpoint; that of a loaded one is a copy."""
        if self._training is not None:
            self._training.save()
        shutil.copytree(self._source or self._run.path, path, dirs_exist_ok=True)

    def render(self, camera: Any, *, options: Any = None) -> dict[str, np.ndarray]:
        """(h, w, 3) sRGB over white or over the surroundings, (h, w) depth along z in the dataset's unit, (h, w) opacity."""
        model = self._model if self._training is None else self._training.state.model
        seen, matrix = camera_of(camera)
        picture = self._renderer.picture(model, View("", seen, matrix, "test", Path()), normals=False)
        return {"color": picture.rgb, "depth": picture.depth[..., 0], "accumulation": picture.opacity[..., 0]}

    def get_train_embedding(self, index: int) -> None:
        """There are no embeddings."""

    def optimize_embedding(self, dataset: Any, *, embedding: Any = None) -> Any:
        """There are no embeddings. Raises NotImplementedError, as the protocol wants."""
        raise NotImplementedError


def _stored(run: Run) -> tuple[Model, int]:
    """Model and step of a run's newest checkpoint."""
    return checkpoint.load_model(run.path / CHECKPOINTS, Model.create(jax.random.key(0), run.config, run.facts))
