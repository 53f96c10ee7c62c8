from pathlib import Path

import jax
import numpy as np
import pytest

from datasets.errors import Misuse
from datasets.scene import Scene
from reconstruct import checkpoint
from reconstruct.config import Config
from reconstruct.run import CHECKPOINTS, Run
from reconstruct.train import start, train


@pytest.fixture
def config(small_config: Config) -> Config:
    """A training of 40 steps, the second pass in its last ones."""
    tree = small_config.model_dump()
    tree["train"]["steps"] = 40
    tree["sampler"] |= {"rays": 128, "samples": 2048}
    tree["surface"] |= {"rays": 16, "first_period": 16, "last_period": 4}
    return Config.model_validate(tree)


def final_leaves(run: Path) -> list[np.ndarray]:
    """What the newest checkpoint of a run holds, as its arrays."""
    found = checkpoint.steps(run / CHECKPOINTS)[-1]
    content = checkpoint._checkpointer().restore(found.resolve())
    return [np.asarray(leaf) for leaf in jax.tree.leaves(content["state"])]


def test_a_resumed_training_ends_at_the_same_bits(ball_scene: tuple[Scene, Path], config: Config, tmp_path: Path) -> None:
    scene, folder = ball_scene
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


def test_a_training_that_cannot_start_leaves_nothing(ball_scene: tuple[Scene, Path], config: Config, tmp_path: Path) -> None:
    scene, folder = ball_scene
    with pytest.raises(Misuse, match="no train views"):
        train(scene.with_views(()), folder, config, tmp_path / "run")
    with pytest.raises(Misuse, match="not a positive time"):
        train(scene, folder, config, tmp_path / "run", budget_s=0.0)
    with pytest.raises(Misuse, match="is not a run"):
        train(scene, folder, config, tmp_path / "run", resume=True)
    assert not (tmp_path / "run").exists()
