"""A run keeps what it was trained with, whatever becomes of the scene's own folder."""

import json
from dataclasses import replace

import numpy as np
import pytest

from koala3d.datasets.core.errors import DatasetError
from koala3d.reconstruct.run import Run
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation


def test_the_box_that_was_measured_for_the_training_is_the_box_of_the_run(ball_scene, small_config, tmp_path):
    scene, folder = ball_scene
    measured = replace(scene, box=0.5 * scene.box, bounds_from="points")
    about = {"box": measured.box.tolist(), "bounds_from": measured.bounds_from}
    run = Run.create(tmp_path / "run", small_config, folder, SceneFacts(Normalisation.of(measured)), about)
    again = Run.open(run.path).scene()
    np.testing.assert_array_equal(again.box, measured.box)
    assert again.bounds_from == "points"


def test_runs_of_earlier_versions_are_read(ball_scene, small_config, tmp_path):
    scene, folder = ball_scene
    path = Run.create(tmp_path / "run", small_config, folder, SceneFacts(Normalisation.of(scene)), {}).path
    content = json.loads((path / "run.json").read_text())
    content["config"]["train"]["accumulate"] = 1
    (path / "run.json").write_text(json.dumps(content))
    assert Run.open(path).config == small_config
    content["config"]["train"]["accumulate"] = 2  # batches that would now be steps of their own
    (path / "run.json").write_text(json.dumps(content))
    with pytest.raises(DatasetError, match="run is not complete"):
        Run.open(path)
