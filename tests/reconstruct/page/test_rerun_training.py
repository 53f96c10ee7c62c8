"""A training in a file of Rerun, read back by Rerun: cameras, pictures, curves, and the surface."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.reports.rerun_file import rerun_file
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.cli import main
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.page.rerun_training import RerunTraining
from koala3d.reconstruct.run import Run
from tests import rrd
from tests.reconstruct.conftest import CENTRE, RADIUS

SMALL = (
    "encoding.levels=1",
    "encoding.log2_size=6",
    "field.spatial_width=4",
    "field.view_width=4",
    "field.bottleneck=2",
    "field.ide_degree=1",
    "sampler.grid=16",
    "sampler.rays=64",
    "sampler.steps=32",
    "sampler.samples=512",
    "surface.enabled=false",
    "train.steps=40",
)

pytest.importorskip("rerun", reason="rerun-sdk is absent: pip install 'koala-capture[rerun]'")


def test_cameras_pictures_and_curves(ball_scene: tuple[Scene, Path], run_inside: Callable, tmp_path: Path) -> None:
    scene, folder = ball_scene
    words = [word for setting in SMALL for word in ("--set", setting)]
    done = run_inside(
        main, "reconstruct", "train", folder, "--out", tmp_path / "run", "--rerun", tmp_path / "training.rrd", *words
    )
    assert done.returncode == 0, done.stderr
    found, log = rrd.read(tmp_path / "training.rrd", "step"), Run.open(tmp_path / "run").log()
    for view in scene.views:
        entity = f"/world/{view.split}/{view.name}"
        assert np.allclose(found[f"{entity} Transform3D:translation"][0][1][0], view.world_from_camera[:3, 3], atol=1e-6)
        assert found[f"{entity} EncodedImage:blob"] and found[f"{entity} Pinhole:resolution"][0][1][0] == [48, 40]
    curve = found["/figures/psnr_train Scalars:scalars"]
    assert [when for when, _ in curve] == [line["step"] for line in log]
    assert [values[0] for _, values in curve] == [line["psnr_train"] for line in log]
    assert {name for line in log for name in line["terms"]} == {key.split()[0].split("/")[2] for key in found if "/loss/" in key}


def test_the_surface_is_in_metres_at_its_step(ball: TrainedModel, tmp_path: Path) -> None:
    """Of two states of a training: the second one's ball is smaller. A state without a surface adds none."""
    smaller = replace(ball.model, field=replace(ball.model.field, radius=0.9 * ball.model.field.radius))
    empty = replace(ball.model, field=replace(ball.model.field, radius=-1.0))
    with rerun_file(tmp_path / "f.rrd", "ball") as shown:
        training = RerunTraining(shown, ball.scene)
        for step, model in enumerate((ball.model, smaller, empty)):
            shown.at(step=step)
            training.surface(replace(ball, model=model))
    surfaces = rrd.read(tmp_path / "f.rrd", "step")["/world/surface Mesh3D:vertex_positions"]
    assert [step for step, _ in surfaces] == [0, 1]
    for (_, vertices), radius in zip(surfaces, (RADIUS, 0.9 * RADIUS), strict=True):
        off = np.linalg.norm(np.array(vertices) - CENTRE, axis=-1) - radius
        assert np.abs(off).max() < 4e-3  # a cell is 3 mm wide; where the density begins is outside the radius
