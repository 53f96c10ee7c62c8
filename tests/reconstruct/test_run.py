"""A run keeps what it was trained with, whatever becomes of the scene's own folder."""

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from reconstruct.run import Run
from reconstruct.scene.rays import Normalisation


def test_the_box_that_was_measured_for_the_training_is_the_box_of_the_run(ball_scene, small_config, tmp_path):
    scene, folder = ball_scene
    measured = replace(scene, box=0.5 * scene.box, bounds_from="points")
    about = {"box": measured.box.tolist(), "bounds_from": measured.bounds_from}
    run = Run.create(tmp_path / "run", small_config, folder, Normalisation.of(measured), about)
    again = Run.open(run.path).scene()
    np.testing.assert_array_equal(again.box, measured.box)
    assert again.bounds_from == "points"


def test_a_run_of_the_first_days_is_read_in_today_s_terms(make_run: Callable[..., Run]) -> None:
    path = make_run(checkpointed=False).path / "run.json"
    content = json.loads(path.read_text())
    sampler, field = content["config"]["sampler"], content["config"]["field"]
    del sampler["frustum"]
    sampler["multisamples"], field["view_skip"], field["view_depth"] = 6, True, 3
    path.write_text(json.dumps(content))
    config = Run.open(path.parent).config
    assert (config.sampler.frustum, config.field.view_skip) == ("hexagon", 2)
