"""A training of the next piece of a series begins with the weights of the first, and with nothing else of it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.scene import Scene
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.models import changed, merged_config
from koala3d.reconstruct.run import CHECKPOINTS, Run
from koala3d.reconstruct.training.beginning.series import WEIGHTS, require_model
from koala3d.reconstruct.training.beginning.starting import resumed, start
from koala3d.reconstruct.training.decisions import record
from koala3d.reconstruct.training.step import Step


@pytest.fixture
def config(small_config: Config) -> Config:
    """With gains of views, which belong to the pictures."""
    changes = {"surface": {"enabled": False}, "train": {"steps": 3, "per_image": "exposure"}}
    return merged_config(small_config, changes)


@pytest.fixture
def first(ball_scene: tuple[Scene, Path], config: Config, tmp_path: Path) -> Run:
    """The run of the first piece, with a checkpoint."""
    training = start(*ball_scene, config, tmp_path / "first")
    training.save()
    return training.run


@pytest.fixture
def another(ball_scene: tuple[Scene, Path]) -> Scene:
    """The next piece: one view fewer."""
    scene = ball_scene[0]
    return scene.with_views(scene.views[:-1])


def test_it_begins_with_the_weights_alone(ball_scene: tuple[Scene, Path], another: Scene, first: Run, tmp_path: Path) -> None:
    run = first
    old, _ = checkpoint.load_model(run.path / CHECKPOINTS, Step.of(run.config, run.facts).initial(jax.random.key(7)).model)
    training = start(another, ball_scene[1], changed(run.config, ["train.seed=5"]), tmp_path / "next", None, run, series=True)
    fresh = training.one_step.initial(jax.random.key(5), None, 3)
    new, anew = training.state.model, fresh.model
    np.testing.assert_array_equal(new.field.encoding.table, old.field.encoding.table)
    assert not np.array_equal(new.field.encoding.table, anew.field.encoding.table), "the premise: these are others"
    assert new.per_image is not None and len(new.per_image) == 3, "one for each training view of the new scene"
    for one, other in zip(jax.tree.leaves(training.state.optimiser), jax.tree.leaves(fresh.optimiser), strict=True):
        np.testing.assert_array_equal(one, other)
    assert int(training.state.step) == 0
    said = Run.open(tmp_path / "next").content[WEIGHTS]
    assert said == {"run": str(run.path), "step": 0, "scene": run.scene_path} and "from" not in training.run.content
    assert record.read(tmp_path / "next") == record.read(run.path) != [], "nothing was decided anew"


def test_one_that_was_killed_before_its_first_checkpoint_begins_with_them_again(
    ball_scene: tuple[Scene, Path], another: Scene, first: Run, tmp_path: Path
) -> None:
    run = first
    training = start(another, ball_scene[1], run.config, tmp_path / "next", None, run, series=True)
    again = resumed(another, tmp_path / "next", None)
    for one, other in zip(jax.tree.leaves(training.state), jax.tree.leaves(again.state), strict=True):
        np.testing.assert_array_equal(one, other)


def test_other_sizes_are_named(ball_scene: tuple[Scene, Path], first: Run, tmp_path: Path) -> None:
    run = first
    wider = changed(run.config, ["field.spatial_width=16"])
    with pytest.raises(ReconstructError, match=r"weights do not fit .*is .*8.* in the checkpoint and .*16.* here.*--set"):
        start(*ball_scene, wider, tmp_path / "next", None, run, series=True)
    assert not (tmp_path / "next").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda scene: {"box": scene.box + 0.01}, "middle"),
        (lambda scene: {"box": scene.box.mean(0) + 1.1 * (scene.box - scene.box.mean(0))}, "half size 0.110"),
        (lambda scene: {"background": "scene"}, "only the scene has surroundings"),
    ],
)
def test_a_scene_that_lies_elsewhere_is_refused(
    ball_scene: tuple[Scene, Path], first: Run, tmp_path: Path, change: Callable, words: str
) -> None:
    scene, folder = ball_scene
    with pytest.raises(UsageError, match=rf"does not lie as the run's.*{words}.*without --from"):
        start(replace(scene, **change(scene)), folder, config, tmp_path / "next", None, first, series=True)


def test_another_model_is_refused(first: Run) -> None:
    run = first
    with pytest.raises(UsageError, match=r"another model.*surfnerf, not zipnerf.*leave --model out"):
        require_model(run, "zipnerf", "fast")
    with pytest.raises(UsageError, match="another preset"):
        require_model(run, "surfnerf", "paper")
    require_model(run, "surfnerf", "fast")
