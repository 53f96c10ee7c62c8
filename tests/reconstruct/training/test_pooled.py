from itertools import pairwise
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.datasets.scene import Scene
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.models import merged_config
from koala3d.reconstruct.run import PICTURES, Run
from koala3d.reconstruct.scene import pool as pools
from koala3d.reconstruct.scene import rays
from koala3d.reconstruct.training.faults import FAULTS as FAULT_BITS
from koala3d.reconstruct.training.loop import start, train
from koala3d.reconstruct.training.objective import LIT


@pytest.fixture
def config(small_config: Config, monkeypatch: pytest.MonkeyPatch) -> Config:
    """A training of 40 steps from a pool of a quarter of the pixels, of which a view is renewed every 15 steps."""
    monkeypatch.setenv(pools.MOST, "2000")
    monkeypatch.setattr(rays, "WORTH_A_COPY", 1)
    tiny = {"train": {"steps": 40}, "sampler": {"rays": 128, "samples": 1024}, "surface": {"enabled": False}}
    return merged_config(small_config, tiny)


def said(run: Path) -> list[dict[str, Any]]:
    """The log without what the clock says."""
    return [{key: value for key, value in line.items() if key != "seconds"} for line in Run.open(run).log()]


def test_each_chunk_draws_from_the_pool_of_its_step(ball_scene: tuple[Scene, Path], config: Config, tmp_path: Path) -> None:
    scene, folder = ball_scene
    training, seen = start(scene, folder, config, tmp_path / "run"), []

    def advance(state, pixels, seed, progress, count, second, looks):
        seen.append(np.asarray(pixels.colour).copy())
        return state, {FAULT_BITS: jnp.zeros((), jnp.int32), LIT: jnp.zeros(())}

    training.advance, training.keep_up = advance, lambda state, seed: state
    assert training.pool is not None and training.pool.period == 16 and len(training.pixels.view) == 2000
    while training.clock.step < 40:
        training.chunk()
    changed = [(before != after).reshape(4, -1).any(-1).sum() for before, after in pairwise(seen)]
    assert changed == [1, 1], "one view after another, every 16 steps"


@pytest.mark.slow
def test_a_training_from_a_pool_repeats_and_resumes(ball_scene: tuple[Scene, Path], config: Config, tmp_path: Path) -> None:
    """First from the pictures' files, then from their copies and interrupted: the last line of the log is the same to the bit."""
    scene, folder = ball_scene
    train(scene, folder, config, tmp_path / "runs" / "first")
    kept = list((tmp_path / "runs" / PICTURES).iterdir())
    assert len(kept) == len(scene.views), "those of training and the unseen one"
    broken = start(scene, folder, config, tmp_path / "runs" / "broken")
    broken.compile()
    while broken.clock.step < 20:
        broken.chunk()
    broken.save()
    train(scene, folder, config, tmp_path / "runs" / "broken", resume=True)
    first, resumed = (said(tmp_path / "runs" / name)[-1] for name in ("first", "broken"))
    assert first == resumed and "psnr_unseen" in first
    assert {file.name: file.stat().st_mtime_ns for file in (tmp_path / "runs" / PICTURES).iterdir()} == {
        file.name: file.stat().st_mtime_ns for file in kept
    }


@pytest.mark.slow
def test_a_pool_learns_what_all_pixels_teach(ball_scene: tuple[Scene, Path], config: Config, tmp_path: Path, monkeypatch) -> None:
    scene, folder = ball_scene
    longer = merged_config(config, {"train": {"steps": 150}})
    pooled = train(scene, folder, longer, tmp_path / "pooled")
    monkeypatch.delenv(pools.MOST)
    whole = train(scene, folder, longer, tmp_path / "whole")
    assert abs(pooled["psnr_unseen"] - whole["psnr_unseen"]) < 1.0  # seeds differ by some tenths
    assert [skip["name"] for skip in pooled["skips"]] == [skip["name"] for skip in whole["skips"]]
