"""Trainings without the minute that their steps take to compile."""

import jax
import jax.numpy as jnp
import pytest

from reconstruct.training.loop import Training


@pytest.fixture
def two_steps_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trainings count two steps that change nothing, in place of steps that have to be compiled."""

    def chunk(training: Training) -> dict[str, jax.Array]:
        training.clock.step += 2
        return {"mse": jnp.asarray(0.01 / training.clock.step), "photometric": jnp.asarray(0.1), "decay": jnp.asarray(1e-9)}

    monkeypatch.setattr(Training, "compile", lambda training: 0.0)
    monkeypatch.setattr(Training, "chunk", chunk)
