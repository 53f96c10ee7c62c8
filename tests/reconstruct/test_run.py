"""A run keeps what it was trained with, whatever becomes of the scene's own folder."""

import json
from collections.abc import Callable
from dataclasses import replace

import jax
import numpy as np
import pytest

from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.run import CHECKPOINTS, Run
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.training.step import Step


def test_the_box_that_was_measured_for_the_training_is_the_box_of_the_run(ball_scene, small_config, tmp_path):
    scene, folder = ball_scene
    measured = replace(scene, box=0.5 * scene.box, bounds_from="points")
    about = {"box": measured.box.tolist(), "bounds_from": measured.bounds_from}
    run = Run.create(tmp_path / "run", small_config, folder, SceneFacts(Normalisation.of(measured)), about)
    again = Run.open(run.path).scene()
    np.testing.assert_array_equal(again.box, measured.box)
    assert again.bounds_from == "points"


def test_a_run_of_the_first_days_is_read_in_today_s_terms(make_run: Callable[..., Run]) -> None:
    path = make_run(checkpointed=False).path / "run.json"
    content = json.loads(path.read_text())
    sampler, field = content["config"]["sampler"], content["config"]["field"]
    del sampler["frustum"]
    sampler["multisamples"], field["view_skip"], field["view_depth"] = 6, True, 3
    content["config"]["skip"] |= {"converged": False, "table_size": True}
    content["facts"]["volume"] = 2.5
    path.write_text(json.dumps(content))
    config = Run.open(path.parent).config
    assert (config.sampler.frustum, config.field.view_skip) == ("hexagon", 2)
    assert config.encoding.volume == 2.5, "tables keep the size that a skip gave them"


def test_a_run_with_facts_in_its_configuration_still_opens(make_run: Callable[..., Run]) -> None:
    """As runs were written before the facts had a place of their own: the values in the configuration count."""
    run = make_run(checkpointed=False)
    path = run.path / "run.json"
    content = json.loads(path.read_text())
    facts = content.pop("facts")
    content["normalisation"] = facts["normalisation"]
    content["config"]["field"] |= {"towards": [0.0, 0.25, 0.5], "half_box": None}
    content["config"]["encoding"]["volume"] = 0.5
    path.write_text(json.dumps(content))
    again = Run.open(run.path)
    assert again.facts == SceneFacts(run.normalisation) and again.config.field.towards == (0.0, 0.25, 0.5)
    state = Step.of(again.config, again.facts).initial(jax.random.key(0))
    assert state.model.field.appearance.start.towards == (0.0, 0.25, 0.5)
    assert again.config.encoding.volume == 0.5


@pytest.mark.parametrize("kind", ["occupancy", "proposal"])
def test_numbered_checkpoints_still_load(make_run: Callable[..., Run], small_config, kind: str) -> None:
    """The first checkpoints numbered their arrays, held moments of the blur, and had the grid behind the optimiser."""
    sampler = small_config.sampler.model_copy(update={"kind": kind, "proposal_finest": (16.0, 32.0)})
    run = make_run(small_config.model_copy(update={"sampler": sampler}), checkpointed=False)
    state = Step.of(run.config, run.facts).initial(jax.random.key(3))
    state = replace(state, step=jax.numpy.asarray(7, jax.numpy.int32))
    numbered = former_leaves(state)
    content = {"state": {f"{i:04d}": leaf for i, leaf in enumerate(numbered)}, "clock": {"seconds": np.asarray(2.0)}}
    checkpoint._checkpointer().save((run.path / CHECKPOINTS / "00000007").resolve(), content)
    like = Step.of(run.config, run.facts).initial(jax.random.key(0))
    found, clock = checkpoint.load(run.path / CHECKPOINTS, like)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(state), strict=True):
        np.testing.assert_array_equal(one, other)
    assert clock == {"seconds": 2.0}
    trained = TrainedModel.open(run.path)
    assert trained.step == 7
    for one, other in zip(jax.tree.leaves(trained.model), jax.tree.leaves(state.model), strict=True):
        np.testing.assert_array_equal(one, other)


def former_leaves(state) -> list[np.ndarray]:
    """Leaves of a state in their former order; moments that are gone are marked by 99."""
    named = jax.tree.leaves_with_path(state.model)
    learned = [leaf for path, leaf in named if ".grid." not in jax.tree_util.keystr(path)]
    grid = [leaf for path, leaf in named if ".grid." in jax.tree_util.keystr(path)]
    moments = []
    for tree in (state.optimiser.mu, state.optimiser.nu):
        own = {jax.tree_util.keystr(path): leaf for path, leaf in jax.tree.leaves_with_path(tree)}
        names = [jax.tree_util.keystr(path) for path, _ in named if ".grid." not in jax.tree_util.keystr(path)]
        moments += [own.get(name, np.asarray(99.0)) for name in names]
    return [np.asarray(leaf) for leaf in [*learned, state.optimiser.count, *moments, *grid, state.step, state.skipped]]
