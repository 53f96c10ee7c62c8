from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.formats import koala, load_scene
from koala3d.datasets.scene import Scene
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.models import finetuned, load_config, merged_config
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.run import CHECKPOINTS, FAULTS, Run
from koala3d.reconstruct.scene.poses import POSES
from koala3d.reconstruct.training.beginning.starting import resumed as again
from koala3d.reconstruct.training.decisions import record
from koala3d.reconstruct.training.faults import FAULTS as FAULT_BITS
from koala3d.reconstruct.training.loop import start, train
from koala3d.reconstruct.training.objective import LIT
from koala3d.reconstruct.training.step import Step
from tests.reconstruct import glossy_ball
from tests.reconstruct.two_sessions import of_two_sessions
from tests.small import small


@pytest.fixture
def config() -> Config:
    """A training of 40 steps, the second pass in its last ones."""
    return small(changes={"train": {"steps": 40}, "surface": {"first_period": 16, "last_period": 4}})


@pytest.mark.parametrize("enabled", [True, False])
def test_the_clock_is_looked_at_every_sixteen_steps_or_where_a_second_pass_is_due(
    ball_scene: tuple[Scene, Path], config: Config, tmp_path: Path, enabled: bool
) -> None:
    """A look at the clock waits for the device: with one at every step a training takes twice as long."""
    config = merged_config(config, {"surface": {"enabled": enabled, "first_period": 8, "last_period": 8}})
    training, done = start(ball_scene[0], ball_scene[1], config, tmp_path / "run", budget_s=1e3), []

    def advance(state, pixels, seed, progress, count, second, looks):
        done.append((int(count), bool(second)))
        return state, {FAULT_BITS: jnp.zeros((), jnp.int32), LIT: jnp.zeros(())}

    training.advance, training.keep_up = advance, lambda state, seed: state
    for _ in range(4):
        training.chunk()
    assert done == ([(8, True)] * 4 if enabled else [(16, False)] * 4)
    assert training.clock.step == (32 if enabled else 64)


def test_steps_look_where_light_ends_once_it_ends_early(ball_scene: tuple[Scene, Path], config: Config, tmp_path: Path) -> None:
    """As the chunk before has shown, of rays with room for eight samples, also after a training is resumed."""
    training, lit, looked = start(*ball_scene, config, tmp_path / "run"), iter([8.0, 5.0, 3.0, 3.0, 4.0]), []

    def advance(state, pixels, seed, progress, count, second, looks):
        looked.append(bool(looks))
        return state, {FAULT_BITS: jnp.zeros((), jnp.int32), LIT: jnp.asarray(next(lit))}

    training.advance, training.keep_up = advance, lambda state, seed: state
    for _ in range(3):
        training.chunk()
    training.save()
    resumed = again(ball_scene[0], tmp_path / "run", None)
    resumed.advance, resumed.keep_up = training.advance, training.keep_up
    for _ in range(2):
        resumed.chunk()
    assert looked == [False, False, False, True, True] and not resumed.clock.looks


@pytest.mark.slow
def test_a_resumed_training_ends_at_the_same_bits(
    ball_scene: tuple[Scene, Path], config: Config, tmp_path: Path, final_leaves: Callable[[Path], list[np.ndarray]]
) -> None:
    scene, folder = ball_scene
    config = merged_config(config, {"poses": {"enabled": True}})
    whole = train(scene, folder, config, tmp_path / "whole")
    assert whole["steps"] == 40 and whole["skipped_steps"] == 0 and np.isfinite(whole["psnr_train"])

    broken = start(scene, folder, config, tmp_path / "broken")
    broken.compile()
    while broken.clock.step < 17:
        broken.chunk()
    assert broken.clock.step < 40
    broken.save()
    resumed = train(scene, folder, config, tmp_path / "broken", resume=True)
    assert resumed["steps"] == 40
    for one, other in zip(final_leaves(tmp_path / "whole"), final_leaves(tmp_path / "broken"), strict=True):
        np.testing.assert_array_equal(one, other)
    assert [line["step"] for line in Run.open(tmp_path / "whole").log()][-1] == 40
    assert [skip["name"] for skip in whole["skips"]] == [skip.name for skip in record.read(tmp_path / "broken")]
    assert files.read_json(tmp_path / "whole" / "skips.json") == whole["skips"] == resumed["skips"]
    assert (tmp_path / "whole" / POSES).read_text() == (tmp_path / "broken" / POSES).read_text()
    trained = TrainedModel.open(tmp_path / "whole")
    assert np.abs(trained.model.poses).max() > 0
    apart = [
        np.abs(old.world_from_camera - new.world_from_camera).max()
        for old, new in zip(scene.views, trained.scene.views, strict=True)
    ]
    assert [bool(size) for size in apart] == [view.split == "train" for view in scene.views], "unseen views keep their poses"


@pytest.mark.usefixtures("two_steps_at_once")
def test_the_motion_of_an_object_that_was_turned_over_is_free_where_it_is_known_badly(
    ball_scene: tuple[Scene, Path], config: Config, tmp_path: Path
) -> None:
    for name, times, poses, free in (("badly", 100, "auto", True), ("well", 1, "auto", False), ("held", 100, False, False)):
        folder, run = tmp_path / f"{name}_scene", tmp_path / name
        koala.save(of_two_sessions(ball_scene[0], times=times), folder)
        train(load_scene(folder), folder, merged_config(config, {"poses": {"enabled": poses}}), run)
        trained = TrainedModel.open(run)
        assert (trained.run.facts.session is not None) == (trained.model.session is not None) == free == (run / POSES).exists()
        (decision,) = [skip for skip in files.read_json(run / "skips.json") if skip["name"] == "poses"]
        assert decision["evidence"].endswith("px and corrected" if free else "px and kept"), decision
    session = Run.open(tmp_path / "badly").facts.session
    assert session is not None and [any(row) for row in session] == [False, False, True, True]
    folder = tmp_path / "badly_scene"
    start(load_scene(folder), folder, config, tmp_path / "again", start_from=Run.open(tmp_path / "badly"))


def test_steps_that_are_not_finite_are_left_out_and_end_the_training_where_they_recur(
    glossy_scene: tuple[Scene, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = load_config(overrides=[*glossy_ball.SETTINGS, "surface.first_period=16"])
    training = start(*glossy_scene, config, tmp_path / "run")
    once = eqx.tree_at(lambda s: s.skipped, training.state, jnp.asarray(1, jnp.int32))
    before, training.state = training.state, once
    training._report_faults(1, {"photometric": jnp.ones(())})
    assert "gradient of field.encoding" in capsys.readouterr().err, "one is shown with its cause, and goes by"
    training.state = before
    training.pixels = eqx.tree_at(lambda p: p.colour, training.pixels, jnp.full_like(training.pixels.colour, jnp.nan))
    start_leaves = [np.asarray(leaf).copy() for leaf in jax.tree.leaves((before.model.split()[0], before.optimiser))]
    training.compile()
    with pytest.raises(ReconstructError, match=r"does not stay finite.*16 steps.*gradient of field\.encoding.*loss photometric"):
        training.chunk()
    learned = (training.state.model.split()[0], training.state.optimiser)
    for leaf, kept in zip(jax.tree.leaves(learned), start_leaves, strict=True):
        np.testing.assert_array_equal(leaf, kept)
    lines = (tmp_path / "run" / FAULTS).read_text().splitlines()
    assert len(lines) == 2 and '"skipped": 16' in lines[1]


def test_a_training_that_cannot_start_leaves_nothing(ball_scene: tuple[Scene, Path], config: Config, tmp_path: Path) -> None:
    scene, folder = ball_scene
    with pytest.raises(UsageError, match="no train views"):
        train(scene.with_views(()), folder, config, tmp_path / "run")
    with pytest.raises(UsageError, match="not a positive time"):
        train(scene, folder, config, tmp_path / "run", budget_s=0.0)
    with pytest.raises(UsageError, match="is not a run"):
        train(scene, folder, config, tmp_path / "run", resume=True)
    assert not (tmp_path / "run").exists()


def test_a_fine_tuning_begins_with_what_the_run_has_learned(
    ball_scene: tuple[Scene, Path], make_run: Callable[..., Run], tmp_path: Path
) -> None:
    scene, folder = ball_scene
    run = make_run(small(changes={"surface": {"enabled": False}}))
    before = checkpoint.load(run.path / CHECKPOINTS, Step.of(run.config, run.facts).initial(jax.random.key(0)))[0]
    tuned = finetuned(run.config, ["train.steps=3"])
    training = start(scene, folder, tuned, tmp_path / "tuned", None, run)
    for one, other in zip(jax.tree.leaves(before.model), jax.tree.leaves(training.state.model), strict=True):
        np.testing.assert_array_equal(one, other)
    assert int(training.state.step) == 0 and training.clock.steps == 3
    assert training.run.facts == run.facts, "what was learned was added to these normals"
    assert (
        training.run.config.surface.enabled and training.run.config.train.rate == training.run.config.train.final_rate == 3.25e-4
    )
    assert Run.open(tmp_path / "tuned").content["from"] == str(run.path)
    with pytest.raises(ReconstructError, match="does not fit"):
        start(scene, folder, merged_config(tuned, {"encoding": {"levels": 5}}), tmp_path / "other", None, run)
    assert not (tmp_path / "other").exists()
