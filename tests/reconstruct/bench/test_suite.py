"""Suites are frozen lists that fit into their time; choices are made of what there is."""

from pathlib import Path

import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.bench.suite import COST, PROFILE, QUALITY, SUITES, Choice, folders, plan
from koala3d.reconstruct.models import load_config


def test_the_quick_suite_leaves_time_for_all_else() -> None:
    trials = plan("quick")
    assert sum(trial.budget_s for trial in trials) <= 300  # of ten minutes; about twenty seconds per trial go beside
    assert len(trials) <= 15
    assert {trial.kind for trial in trials} == {QUALITY, COST, PROFILE}


def test_the_full_suite_has_every_budget_scene_and_seed() -> None:
    trials = [trial for trial in plan("full") if trial.kind == QUALITY and trial.model == "surfnerf" and trial.preset == "fast"]
    assert {trial.budget_s for trial in trials} == {15, 30, 60, 120, 300}
    assert len({trial.scene for trial in trials}) == 12 and {trial.seed for trial in trials} == {0, 1, 2}
    assert len(trials) == (5 * 8 + 2 * 5) * 3  # scenes under near lamps after one and two minutes


@pytest.mark.parametrize("suite", SUITES)
def test_trials_are_told_apart_and_can_be_configured(suite: str) -> None:
    trials = plan(suite)
    assert len({trial.key for trial in trials}) == len(trials)
    for model, preset in {(trial.model, trial.preset) for trial in trials}:
        load_config(model, preset)


def test_choices() -> None:
    trials = plan("quick", Choice(scenes=("teapot",), models=("zipnerf",), budgets_s=(60.0,), seeds=(5,)))
    assert [trial.name for trial in trials] == ["quality-teapot-1-0-zipnerf-fast-60-5"]
    chosen = Choice(("lego400",), scales=(0.5,), models=("surfnerf",), presets=("fast",), budgets_s=(60.0,), seeds=(0,))
    assert [trial.name for trial in plan("full", chosen)] == ["quality-lego400-0.5-0-surfnerf-fast-60-0"]
    with pytest.raises(UsageError, match=r"full has no such trial.*scales are 0\.25, 0\.5, 1, presets fast, paper"):
        plan("full", Choice(scenes=("lego400",), scales=(0.3,)))
    with pytest.raises(UsageError, match="did you mean 'gold_rings'"):
        plan("quick", Choice(scenes=("gold_ring",)))
    with pytest.raises(UsageError, match="did you mean 'quick'"):
        plan("quik")


def test_scenes_that_are_absent_are_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("KOALA_DATA", raising=False)
    (tmp_path / "data" / "mold_gold_cape").mkdir(parents=True)
    trials = [trial for trial in plan("full") if trial.scene in ("lego400", "mold_gold_cape")]
    assert folders(trials, tmp_path / "made", tmp_path / "data") == {"mold_gold_cape": tmp_path / "data" / "mold_gold_cape"}
