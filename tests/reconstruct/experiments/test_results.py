"""Rows of runs on disk, and what seeds make of them."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.reconstruct.run import Run
from koala3d.reconstruct.studies.results import row_of_seeds, rows_of_runs


@pytest.fixture
def measured(make_run: Callable[..., Run], tmp_path: Path) -> Callable[..., Path]:
    """Factory of measured runs: `make_run`'s with other settings, and figures as an evaluation leaves them."""
    original = json.loads((make_run(checkpointed=False).path / "run.json").read_text())

    def make(name: str, psnr: float, *, seed: int = 0, changes: dict[str, object] | None = None, **content: object) -> Path:
        path = tmp_path / "measured" / name
        path.mkdir(parents=True)
        config = json.loads(json.dumps(original["config"]))
        config["train"] |= {"seed": seed, **(changes or {})}
        views = [{"name": "000", "psnr": psnr - 1}, {"name": "003", "psnr": psnr + 1}]
        (path / "run.json").write_text(json.dumps({**original, "config": config, "budget_s": 60.0, **content}))
        metrics = {"format": "koala-metrics", "version": 1, "mean": {"psnr": psnr}, "per_view": views, "mesh": {"f_score": 0.5}}
        (path / "metrics.json").write_text(json.dumps(metrics))
        return path

    return make


def test_a_run_that_was_not_measured_is_named(measured: Callable[..., Path]) -> None:
    bare, broken = measured("bare", 20.0), measured("broken", 20.0)
    (bare / "metrics.json").unlink()
    with pytest.raises(UsageError, match=r"bare: has not been evaluated.*reconstruct eval"):
        rows_of_runs([bare])
    (broken / "metrics.json").write_text(json.dumps({"format": "koala-metrics", "version": 1, "per_view": []}))
    with pytest.raises(DatasetError, match=r"broken/metrics\.json: metrics are incomplete"):
        rows_of_runs([broken])


def test_seeds_of_one_training_make_one_row(measured: Callable[..., Path]) -> None:
    runs = [measured(f"run{seed}", 20.0 + seed, seed=seed) for seed in (0, 1, 2)]
    (row,) = rows_of_runs(runs)
    assert (row.label, row.seeds, row.values["psnr"], row.values["f_score"]) == ("surfnerf", 3, 21.0, 0.5)
    assert row.deviations == {"psnr": 1.0, "f_score": 0.0}
    assert row.content(["psnr", "lpips"]) == {"psnr": 21.0, "psnr_std": 1.0, "lpips": None, "seeds": 3}
    assert rows_of_runs(runs[:1])[0].content(["psnr"]) == {"psnr": 20.0}


@pytest.mark.parametrize(
    "other", [{"seed": 0}, {"seed": 1, "changes": {"rate": 0.02}}, {"seed": 1, "budget_s": 30.0}, {"seed": 1, "device": "gpu"}]
)
def test_what_differs_in_more_than_its_seed_or_in_nothing_stays_apart(
    measured: Callable[..., Path], tmp_path: Path, other: dict[str, object]
) -> None:
    rows = rows_of_runs([measured("one", 20.0), measured("two", 22.0, **other)])
    assert [(row.label, row.seeds, row.values["psnr"]) for row in rows] == [("surfnerf", 1, 20.0), ("surfnerf (two)", 1, 22.0)]
    with pytest.raises(UsageError, match="measured: seeds were not trained alike"):
        row_of_seeds([tmp_path / "measured/one", tmp_path / "measured/two"])


def test_trainings_of_one_model_are_named_after_the_folder_that_holds_their_seeds(measured: Callable[..., Path]) -> None:
    base = [measured(f"base/seed_{seed}", 20.0, seed=seed) for seed in (4, 5)]
    other = measured("other/seed_4", 20.0, seed=4, changes={"rate": 0.02})
    rows = rows_of_runs([*base, other])
    assert [(row.label, row.seeds) for row in rows] == [("surfnerf", 2), ("surfnerf (other)", 1)]


def test_a_figure_that_one_seed_lacks_is_lacking(measured: Callable[..., Path]) -> None:
    runs = [measured("run0", 20.0), measured("run1", 21.0, seed=1)]
    metrics = json.loads((runs[1] / "metrics.json").read_text())
    (runs[1] / "metrics.json").write_text(json.dumps({**metrics, "mesh": None}))
    (row,) = rows_of_runs(runs)
    assert row.values == {"psnr": 20.5, "f_score": None} and "f_score" not in row.deviations


def test_images_are_rows_of_their_own(measured: Callable[..., Path]) -> None:
    runs = [measured("run0", 20.0), measured("run1", 30.0, seed=1)]
    rows = rows_of_runs(runs, per_image=True)
    assert [(row.label, row.values["psnr"]) for row in rows] == [("000", 19.0), ("003", 21.0), ("000", 29.0), ("003", 31.0)]
    assert [row.scene.split(", ")[1] for row in rows[::2]] == ["surfnerf", "surfnerf (run1)"]
