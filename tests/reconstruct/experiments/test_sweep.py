"""The bookkeeping of sweeps; the trainings are stubs."""

import os
import shutil
import sys
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.extras import not_installed
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.cli import app
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.experiments import sweep
from koala3d.reconstruct.experiments.jobs import Job
from koala3d.reconstruct.experiments.waiting import Batches, Runner
from tests.reconstruct.experiments.odd_jobs import write_run


@pytest.fixture
def ran() -> list[str]:
    """Names of the jobs that ran."""
    return []


@pytest.fixture
def runner(ran: list[str]) -> Runner[Job]:
    """Writes results as trainings do; `zipnerf` fails while a file named `broken` exists beside the sweep."""

    def run_all(batches: Batches[Job]) -> Iterator[tuple[Job, str]]:
        for job in chain.from_iterable(batches):
            ran.append(job.name)
            broken = job.recipe.model == "zipnerf" and (job.path.parents[4] / "broken").exists()
            if not broken:
                write_run(job, 20.0 + len(ran))
            yield job, "training does not stay finite" if broken else ""

    return run_all


@pytest.fixture
def scene(ball_scene: tuple[Scene, Path]) -> str:
    return str(ball_scene[1])


def test_a_failure_leaves_the_other_runs_and_can_be_repeated(scene: str, tmp_path: Path, runner: Runner[Job]) -> None:
    (tmp_path / "broken").write_text("")
    out = tmp_path / "sweep"
    wanted = sweep.plan([scene], ["zipnerf", "surfnerf"], "fast", ["train.seed=1"], out, budgets=[5.0])
    assert [job.path for job in wanted] == [out / f"ball/{model}/base_5s/seed_1" for model in ("zipnerf", "surfnerf")]
    with pytest.raises(
        ReconstructError, match=r"1 of 2 runs failed \(ball/zipnerf/base_5s/seed_1: training does not stay finite\)"
    ):
        sweep.run(wanted, out, runner)
    assert "surfnerf" in (out / "table.md").read_text() and "zipnerf" not in (out / "table.md").read_text()
    (tmp_path / "broken").unlink()
    assert sweep.run(wanted, out, runner) == {"out": str(out), "runs": 2, "trained": 1, "table": str(out / "table.md")}
    assert "zipnerf" in (out / "table.tex").read_text() and "zipnerf" in (out / "index.html").read_text()


def test_settings_and_seeds_make_rows_with_means(scene: str, tmp_path: Path, runner: Runner[Job], ran: list[str]) -> None:
    tried = ["sampling random", "scale=0.5 surface.bias=0"]
    wanted = sweep.plan([scene], ["surfnerf"], "fast", [], tmp_path, settings=tried, seeds=[0, 2])
    assert sweep.run(wanted, tmp_path, runner)["runs"] == 6
    first = [f"ball/surfnerf/{name}/seed_0" for name in ("base", "sampling_random", "scale=0.5_surface.bias=0")]
    assert ran[:3] == first and ran[3] == "ball/surfnerf/base/seed_2"
    assert wanted[2].changes == ("scale=0.5", "surface.bias=0", "train.seed=0")
    rows = [line for line in (tmp_path / "table.md").read_text().splitlines() if "nerf" in line]
    assert rows == [
        "| ball | surfnerf | 22.50 ± 2.12 | 27.50 ± 2.12 |",
        "|  | surfnerf, sampling random | 23.50 ± 2.12 | 26.50 ± 2.12 |",
        "|  | surfnerf, scale=0.5 surface.bias=0 | **24.50 ± 2.12** | **25.50 ± 2.12** |",
    ]
    page = (tmp_path / "index.html").read_text()
    named = "--try &#39;sampling random&#39; --try &#39;scale=0.5 surface.bias=0&#39; --seed 0 --seed 2 --preset fast"
    assert named in page and "Gain over the base" in page and "95 % confidence" in page and "surface.sampling=random" in page


def test_all_of_the_papers_ablations_are_one_word(scene: str, tmp_path: Path) -> None:
    wanted = sweep.plan([scene], ["surfnerf"], "fast", [], tmp_path, settings=["paper"])
    assert len(wanted) > 10 and wanted[0].setting == "base" and "no regulariser" in [job.setting for job in wanted]


def test_a_sweep_is_resumed_with_the_same_settings_only(scene: str, tmp_path: Path, runner: Runner[Job]) -> None:
    out = tmp_path / "sweep"

    def ask(model: str, *overrides: str, where: str = scene, **axes: Any) -> dict[str, Any]:
        return sweep.run(sweep.plan([where], [model], "fast", overrides, out, **axes), out, runner)

    ask("zipnerf")
    with pytest.raises(UsageError, match=r"overrides was nothing, and is scale=0\.5 now"):
        ask("surfnerf", "scale=0.5")
    elsewhere = tmp_path / "ball"
    shutil.copytree(scene, elsewhere)
    with pytest.raises(UsageError, match=r"started with other settings.*scenes\.ball was"):
        ask("zipnerf", where=str(elsewhere))
    assert not (out / "ball/surfnerf").exists(), "refused before any training"
    assert ask("surfnerf") == {"out": str(out), "runs": 2, "trained": 1, "table": str(out / "table.md")}
    assert ask("surfnerf", budgets=[3.0], settings=["sampling random"])["runs"] == 4, "settings and budgets can be added"
    table = (out / "table.md").read_text()
    assert "zipnerf" in table and "surfnerf" in table and "sampling random" in table
    (tmp_path / "other").mkdir()
    (tmp_path / "other/notes.txt").write_text("mine")
    with pytest.raises(UsageError, match="already exists"):
        sweep.run(sweep.plan([scene], ["zipnerf"], "fast", [], tmp_path / "other"), tmp_path / "other", runner)


@pytest.mark.parametrize(("models", "axes", "complaint"), [
    (["zipnrf"], {}, "did you mean 'zipnerf'"),
    (["surfnerf"], {"settings": ["k=5"]}, "unknown key 'k'"),
    (["surfnerf"], {"settings": ["sampling rando"]}, "did you mean 'sampling random'"),
    (["surfnerf"], {"seeds": [1, 2, 1]}, "a seed is given twice"),
])  # fmt: skip
def test_wrong_requests_are_named(scene: str, tmp_path: Path, models: list[str], axes: dict[str, Any], complaint: str) -> None:
    with pytest.raises(UsageError, match=complaint):
        sweep.plan([scene], models, "fast", [], tmp_path, **axes)


def test_two_scenes_of_one_name_are_refused(scene: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="two scenes have the same name"):
        sweep.plan([scene, scene], ["zipnerf"], "fast", [], tmp_path)


def invoke(*words: object) -> Any:
    return CliRunner().invoke(app, list(map(str, words)))


def test_the_plan_trains_nothing(scene: str, tmp_path: Path) -> None:
    said = invoke(
        "sweep", "--scene", scene, "--try", "sampling random", "--seed", 0, "--seed", 1, "--plan", "--out", tmp_path / "none"
    )
    assert "ball/surfnerf/sampling_random/seed_0  surface.sampling=random\n" in said.stdout
    assert said.stdout.splitlines()[-1] == "4 trainings" and not (tmp_path / "none").exists()


def test_two_sweeps_are_compared_and_written(scene: str, tmp_path: Path, runner: Runner[Job], ran: list[str]) -> None:
    for name in ("before", "after"):
        wanted = sweep.plan([scene], ["surfnerf"], "fast", [], tmp_path / name, seeds=range(3))
        sweep.run(wanted, tmp_path / name, runner)
        ran += ["pause"] * 20  # whose results are better by as many decibels
    words = ("table", tmp_path / "after", "--against", tmp_path / "before")
    said = invoke(*words, "--out", tmp_path / "page.html")
    assert "better" in said.stdout and "psnr" in said.stdout and "<table" in (tmp_path / "page.html").read_text()
    assert "tables are not written as '.md'" in str(invoke(*words, "--out", tmp_path / "table.md").exception)
    shown = invoke("table", tmp_path / "after", "--out", tmp_path / "table.html")
    assert "| ball | surfnerf | 45.00 ± 1.00" in shown.stdout and "45.0 ± 1.0" in (tmp_path / "table.html").read_text()


def test_relative_paths_are_those_of_the_first_working_directory(
    scene: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, runner: Runner[Job]
) -> None:
    monkeypatch.chdir(tmp_path)
    (job,) = wanted = sweep.plan([os.path.relpath(scene)], ["surfnerf"], "fast", [], Path("sweep"))
    assert job.path == tmp_path / "sweep/ball/surfnerf/base/seed_0" and job.recipe.scene == scene
    result = sweep.run(wanted, Path("sweep"), runner)
    assert result == {"out": str(tmp_path / "sweep"), "runs": 1, "trained": 1, "table": str(tmp_path / "sweep/table.md")}
    monkeypatch.chdir("/")
    out = tmp_path / "sweep"
    assert sweep.run(sweep.plan([scene], ["surfnerf"], "fast", [], out), out, runner) == result | {"trained": 0}


def test_without_ray_its_extra_is_named(scene: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "koala3d.reconstruct.experiments.on_ray", raising=False)
    said = invoke("sweep", "--scene", scene, "--ray", "--out", tmp_path)
    assert isinstance(said.exception, ModuleNotFoundError)
    assert str(not_installed(said.exception)) == "ray is not installed; pip install 'koala-capture[sweep]'"
