"""A budget becomes a number of steps, corrected after each quarter; what is trained then follows the steps alone."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.scene import Scene
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.models import merged_config
from koala3d.reconstruct.run import CHECKPOINTS, Run
from koala3d.reconstruct.training import training
from koala3d.reconstruct.training.faults import FAULTS
from koala3d.reconstruct.training.loop import train
from koala3d.reconstruct.training.objective import LIT
from koala3d.reconstruct.training.pace import budget
from koala3d.reconstruct.training.pace.budget import Plan
from koala3d.reconstruct.training.pace.clock import Clock, Leg
from koala3d.reconstruct.training.schedule import Schedule
from koala3d.reconstruct.training.training import Training

PLAIN_S, SECOND_S = 0.04, 0.12


class Machine:
    """A clock that only training moves; it becomes slower at a step."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, slower_from: int = 10**9, factor: float = 1.0) -> None:
        self.now, self.slower_from, self.factor = 0.0, slower_from, factor
        self.progress: list[float] = []
        self.kill_at = 10**9
        fake = SimpleNamespace(perf_counter=lambda: self.now)
        for module in (budget, training):
            monkeypatch.setattr(module, "time", fake)
        monkeypatch.setattr(Training, "compile", lambda of: self.compile(of))

    def compile(self, of: Training) -> float:
        def advance(state, pixels, seed, progress, count, second, looks):
            slow = self.factor if of.clock.step >= self.slower_from else 1.0
            self.now += slow * (PLAIN_S * (count - second) + SECOND_S * second)
            self.progress.append(float(progress))
            if of.clock.step >= self.kill_at:
                raise KoalaError("killed")
            state = state.__class__(state.model, state.optimiser, state.step + count, state.skipped)
            return state, {FAULTS: jnp.zeros((), jnp.int32), "mse": jnp.ones(()), LIT: jnp.ones(())}

        of.advance, of.keep_up = advance, lambda state, seed: state
        return 0.0


@pytest.fixture
def config(small_config: Config) -> Config:
    return merged_config(small_config, {"surface": {"first_period": 64, "last_period": 4}, "train": {"checkpoint_s": 60}})


def test_second_passes_that_become_more_frequent_are_counted(config: Config) -> None:
    plan = Plan(PLAIN_S, SECOND_S, (0.0, 0, 0))
    late, whole = (plan.step_s(Schedule(config), begin) for begin in (0.99, 0.0))
    assert late == pytest.approx(PLAIN_S + (SECOND_S - PLAIN_S) / 4, rel=1e-6)
    assert PLAIN_S < whole < late


def test_progress_is_that_of_as_many_steps_and_bends_where_it_was_corrected() -> None:
    clock, plain = Clock(1, 60.0, legs=[Leg(0, 0.0, 977)]), Clock(977, None)
    for step in range(978):
        clock.step = plain.step = step
        assert clock.progress == plain.progress == (step / 977 if step < 977 else 1.0)
    clock.legs.append(Leg(400, 0.25, 500))
    for step, (progress, left) in {399: (399 / 977, 1), 400: (0.25, 100), 450: (0.625, 50), 500: (1.0, 0)}.items():
        clock.step = step
        assert (clock.progress, clock.left) == (pytest.approx(progress), left)


@pytest.mark.parametrize("enabled", [True, False])
def test_a_steady_machine_ends_at_its_budget_uncorrected(
    ball_scene: tuple[Scene, Path], config: Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, enabled: bool
) -> None:
    machine = Machine(monkeypatch)
    config = merged_config(config, {"surface": {"enabled": enabled}})
    result = train(*ball_scene, config, tmp_path / "run", budget_s=20.0)
    assert result["training_s"] == pytest.approx(20.0, rel=0.02) and not result["steps_corrected"]
    assert machine.now == pytest.approx(result["training_s"]), "the trial's time counts"
    plan = Run.open(tmp_path / "run").content["plan"]
    assert plan["legs"] == [[0, 0.0, result["steps"]]] and plan["checked"]
    assert machine.progress[-1] < 1 and sorted(machine.progress) == machine.progress


@pytest.mark.parametrize(("factor", "corrected"), [(1.03, False), (2.0, True), (0.5, True)])
def test_a_machine_that_changes_is_noticed(
    ball_scene: tuple[Scene, Path],
    config: Config,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    factor: float,
    corrected: bool,
) -> None:
    machine = Machine(monkeypatch, slower_from=0, factor=1.0)
    begin = budget.begin

    def then_changed(of: Training) -> None:
        begin(of)
        machine.factor = factor

    monkeypatch.setattr(budget, "begin", then_changed)
    result = train(*ball_scene, config, tmp_path / "run", budget_s=20.0)
    assert result["steps_corrected"] == corrected
    assert result["training_s"] == pytest.approx(20.0, rel=0.02 if corrected else 0.1)
    assert np.max(np.diff(machine.progress)) < 0.2, "no more than a chunk of few steps: schedules do not jump"


def test_steps_that_take_longer_towards_the_end_do_not_take_the_training_past_its_budget(
    ball_scene: tuple[Scene, Path], config: Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Machine(monkeypatch, slower_from=250, factor=1.5)  # of 404
    result = train(*ball_scene, config, tmp_path / "run", budget_s=20.0)
    legs = Run.open(tmp_path / "run").content["plan"]["legs"]
    assert len(legs) == 2 and legs[1][0] > 250 and result["steps"] < legs[0][2]
    assert result["training_s"] == pytest.approx(20.0, rel=0.05), "3.8 s more where nothing is corrected"


def test_a_resumed_training_goes_on_to_the_number_that_was_fixed(
    ball_scene: tuple[Scene, Path], config: Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    machine = Machine(monkeypatch, slower_from=0, factor=1.0)
    config = merged_config(config, {"train": {"checkpoint_s": 1e-9}})
    whole = train(*ball_scene, config, tmp_path / "whole", budget_s=8.0)
    undisturbed = machine.progress[-5:]
    for where in (40, 100):
        machine.kill_at = where
        out = tmp_path / f"killed_{where}"
        with pytest.raises(KoalaError, match="killed"):
            train(*ball_scene, config, out, budget_s=8.0)
        machine.kill_at, machine.factor = 10**9, 1.05
        assert checkpoint.steps(out / CHECKPOINTS)
        result = train(*ball_scene, config, out, resume=True, budget_s=500.0)
        assert "planned for 8 s" in capsys.readouterr().err
        assert result["steps"] == whole["steps"] and machine.progress[-5:] == undisturbed
        machine.factor = 1.0


@pytest.mark.slow
def test_the_fixed_number_of_steps_repeats_a_budget_to_the_bit(
    ball_scene: tuple[Scene, Path], config: Config, tmp_path: Path, final_leaves: Callable[[Path], list[Any]], monkeypatch
) -> None:
    monkeypatch.setattr(budget, "TOLERANCE", np.inf)  # this machine's rate is not steady enough to rely on
    tiny = {"sampler": {"rays": 128, "samples": 2048}, "surface": {"rays": 16, "first_period": 16}, "train": {"checkpoint_s": 60}}
    config = merged_config(config, tiny)
    timed = train(*ball_scene, config, tmp_path / "timed", budget_s=6.0)
    again = merged_config(config, {"train": {"steps": timed["steps"]}})
    assert train(*ball_scene, again, tmp_path / "again")["steps"] == timed["steps"] > 1
    for one, other in zip(final_leaves(tmp_path / "timed"), final_leaves(tmp_path / "again"), strict=True):
        np.testing.assert_array_equal(one, other)
    logs = [Run.open(tmp_path / name).log() for name in ("timed", "again")]
    assert [[line["step"], line["terms"]] for line in logs[0]] == [[line["step"], line["terms"]] for line in logs[1]]
