"""Trials run in processes, results outlive failures, and what is done is not done again."""

from pathlib import Path
from typing import Any

import pytest

from koala3d.datasets.core.errors import KoalaError
from koala3d.reconstruct.bench import runner
from koala3d.reconstruct.bench.records import Records
from koala3d.reconstruct.bench.suite import QUALITY, Trial
from koala3d.reconstruct.bench.trial import chosen_views

TRIAL = Trial(QUALITY, "lego400", 1.0, 0, "surfnerf", "fast", 1.0, 0)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A folder in which a scene seems to be."""
    (tmp_path / "data" / "lego400").mkdir(parents=True)
    return tmp_path / "data"


def test_a_trial_that_fails_leaves_its_reason(tmp_path: Path, data: Path) -> None:
    told = runner.run([TRIAL], tmp_path / "out", data=data)
    assert told["failed"] == 1 and told["done"] == 0
    (row,) = Records(tmp_path / "out" / runner.RECORDS).rows()
    assert row["status"].startswith("failed: ") and "holds no scene" in row["status"]
    assert row["jax"] and row["machine"] and row["cores"] >= 1 and row["psnr"] is None


def test_what_is_done_is_not_done_again(tmp_path: Path, data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def pretend(one: Trial, place: Path, folder: Path, *_: Any) -> dict[str, Any]:
        asked.append(one)
        if one.seed == 1 and len(asked) == 2:
            raise KoalaError("trial failed", why="no memory")
        return {"psnr": 20.0 + one.seed}

    monkeypatch.setattr(runner, "_in_a_process", pretend)
    trials = [Trial(*(*TRIAL.__dict__.values(),)[:-1], seed) for seed in range(3)]
    out = tmp_path / "out"
    assert runner.run(trials, out, data=data) == {"out": str(out), "done": 2, "there": 0, "failed": 1, "absent": []}
    assert runner.run(trials, out, data=data)["done"] == 1  # the one that failed
    assert len(asked) == 4 and asked[-1].seed == 1
    elsewhere = Trial(QUALITY, "mold_gold_cape", 1.0, 0, "surfnerf", "fast", 1.0, 0)
    assert runner.run([elsewhere], out, data=data)["absent"] == ["mold_gold_cape"]


def test_views_are_chosen_evenly(ball_scene: tuple) -> None:
    scene, _ = ball_scene
    names = [view.name for view in scene.split("train")]
    few = chosen_views(scene, 2)
    assert [view.name for view in few.split("train")] == [names[0], names[-1]]
    assert len(few.split("test")) == len(scene.split("test"))
    assert chosen_views(scene, 0) is scene and chosen_views(scene, 99) is scene
