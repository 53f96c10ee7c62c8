"""Trainings without the minute that their steps take to compile."""

from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.run import CHECKPOINTS
from koala3d.reconstruct.training.training import Training


@pytest.fixture
def two_steps_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trainings count two steps that change nothing, in place of steps that have to be compiled."""

    def chunk(training: Training) -> dict[str, jax.Array]:
        training.clock.step += 2
        return {"mse": jnp.asarray(0.01 / training.clock.step), "photometric": jnp.asarray(0.1), "decay": jnp.asarray(1e-9)}

    monkeypatch.setattr(Training, "compile", lambda training: 0.0)
    monkeypatch.setattr(Training, "chunk", chunk)


@pytest.fixture
def final_leaves() -> Callable[[Path], list[np.ndarray]]:
    """What the newest checkpoint of a run holds, as its arrays."""

    def leaves(run: Path) -> list[np.ndarray]:
        found = checkpoint.steps(run / CHECKPOINTS)[-1]
        content = checkpoint._checkpointer().restore(found.resolve())
        return [np.asarray(leaf) for leaf in jax.tree.leaves(content["state"])]

    return leaves
