"""Rows of runs on disk, and what seeds make of them."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.reconstruct.experiments.results import Result, results_of, rows_of
from koala3d.reconstruct.run import Run


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
        rows_of(results_of([bare]))
    (broken / "metrics.json").write_text(json.dumps({"format": "koala-metrics", "version": 1, "per_view": []}))
    with pytest.raises(DatasetError, match=r"broken: metrics are incomplete"):
        rows_of(results_of([broken]))


def test_seeds_of_one_training_make_one_row(measured: Callable[..., Path]) -> None:
    runs = [measured(f"run{seed}", 20.0 + seed, seed=seed) for seed in (0, 1, 2)]
    (row,) = rows_of(results_of(runs))
    assert (row.label, row.seeds, row.values["psnr"], row.values["f_score"]) == ("surfnerf", 3, 21.0, 0.5)
    assert row.deviations == {"psnr": 1.0, "f_score": 0.0}
    assert row.content(["psnr", "lpips"]) == {"psnr": 21.0, "psnr_std": 1.0, "lpips": None, "seeds": 3}
    assert rows_of(results_of(runs[:1]))[0].content(["psnr"]) == {"psnr": 20.0}


@pytest.mark.parametrize(
    "other", [{"seed": 0}, {"seed": 1, "changes": {"rate": 0.02}}, {"seed": 1, "budget_s": 30.0}, {"seed": 1, "device": "gpu"}]
)
def test_what_differs_in_more_than_its_seed_or_in_nothing_stays_apart(
    measured: Callable[..., Path], other: dict[str, object]
) -> None:
    rows = rows_of(results_of([measured("one", 20.0), measured("two", 22.0, **other)]))
    names = ("surfnerf, 60 s", "surfnerf, 30 s") if "budget_s" in other else ("surfnerf", "surfnerf (two)")
    assert [(row.label, row.seeds, row.values["psnr"]) for row in rows] == [(names[0], 1, 20.0), (names[1], 1, 22.0)]


def test_a_result_is_read_as_it_was_written(measured: Callable[..., Path], tmp_path: Path) -> None:
    place = tmp_path / "sweep/ball/surfnerf/without_bias/seed_3.json"
    run = measured("run", 20.0, seed=3)
    found = Result.of_run(run, setting="without bias", work={"rays_per_s": 5e4}, machine={"cores": 2})
    files.write_json(place, found.content())
    (read,) = results_of([tmp_path / "sweep"])
    assert replace(read, path=run) == found and read.recipe == found.recipe
    (row,) = rows_of([read])
    assert row.label == "surfnerf, without bias" and row.values["rays_per_s"] == 5e4 and row.values["psnr"] == 20.0
    assert str(row.origin) == "surfnerf, without bias, fast, 60 s"
    files.write_json(place, {"format": "koala-result", "version": 1, "origin": {}})
    with pytest.raises(DatasetError, match=r"seed_3\.json: result is incomplete"):
        results_of([tmp_path / "sweep"])
    with pytest.raises(UsageError, match="holds no results"):
        results_of([tmp_path])


def test_trainings_of_one_model_are_named_after_the_folder_that_holds_their_seeds(measured: Callable[..., Path]) -> None:
    base = [measured(f"base/seed_{seed}", 20.0, seed=seed) for seed in (4, 5)]
    other = measured("other/seed_4", 20.0, seed=4, changes={"rate": 0.02})
    rows = rows_of(results_of([*base, other]))
    assert [(row.label, row.seeds) for row in rows] == [("surfnerf", 2), ("surfnerf (other)", 1)]


def test_a_figure_that_one_seed_lacks_is_lacking(measured: Callable[..., Path]) -> None:
    runs = [measured("run0", 20.0), measured("run1", 21.0, seed=1)]
    metrics = json.loads((runs[1] / "metrics.json").read_text())
    (runs[1] / "metrics.json").write_text(json.dumps({**metrics, "mesh": None}))
    (row,) = rows_of(results_of(runs))
    assert row.values == {"psnr": 20.5, "f_score": None} and "f_score" not in row.deviations


def test_images_are_rows_of_their_own(measured: Callable[..., Path]) -> None:
    runs = [measured("run0", 20.0), measured("run1", 30.0, seed=1)]
    rows = rows_of(results_of(runs), per_image=True)
    assert [(row.label, row.values["psnr"]) for row in rows] == [("000", 19.0), ("003", 21.0), ("000", 29.0), ("003", 31.0)]
    assert [row.scene.split(", ")[1] for row in rows[::2]] == ["surfnerf", "surfnerf (run1)"]
