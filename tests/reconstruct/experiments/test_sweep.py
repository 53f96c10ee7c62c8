"""The bookkeeping of sweeps; the trainings are stubs."""

import os
import shutil
import sys
from pathlib import Path

import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.extras import not_installed
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.studies import sweep
from koala3d.reconstruct.studies.jobs import Job
from tests.reconstruct.studies.odd_jobs import write_run


def stub(job: Job) -> None:
    """Write a run as training and evaluation do; `zipnerf` fails while a file named `broken` exists beside the sweep."""
    if job.recipe.model == "zipnerf" and (job.path.parents[3] / "broken").exists():
        raise ReconstructError("training does not stay finite")
    write_run(job)


@pytest.fixture
def no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweep, "cache_compilations", lambda: None)


def test_a_failure_leaves_the_other_runs_and_can_be_repeated(
    ball_scene: tuple[Scene, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, no_cache: None
) -> None:
    monkeypatch.setattr(Job, "run", stub)
    (tmp_path / "broken").write_text("")
    out = tmp_path / "sweep"
    wanted = sweep.plan([str(ball_scene[1])], ["zipnerf", "surfnerf"], "fast", ["train.seed=1"], 5.0, out)
    assert [job.path for job in wanted] == [out / "ball/zipnerf/seed_1", out / "ball/surfnerf/seed_1"]
    with pytest.raises(ReconstructError, match=r"1 of 2 runs failed \(ball/zipnerf/seed_1: training does not stay finite\)"):
        sweep.run(wanted, out)
    assert "surfnerf" in (out / "table.md").read_text() and "zipnerf" not in (out / "table.md").read_text()
    (tmp_path / "broken").unlink()
    assert sweep.run(wanted, out) == {"out": str(out), "runs": 2, "trained": 1, "table": str(out / "table.md")}
    assert "zipnerf" in (out / "table.tex").read_text()


def test_seeds_of_a_model_make_one_row(
    ball_scene: tuple[Scene, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, no_cache: None
) -> None:
    monkeypatch.setattr(Job, "run", stub)
    wanted = sweep.plan([str(ball_scene[1])], ["zipnerf", "surfnerf"], "fast", [], 5.0, tmp_path, [0, 2])
    names = ["/".join(job.path.parts[-3:]) for job in wanted]
    assert names == ["ball/zipnerf/seed_0", "ball/surfnerf/seed_0", "ball/zipnerf/seed_2", "ball/surfnerf/seed_2"]
    assert sweep.run(wanted, tmp_path)["runs"] == 4
    rows = [line for line in (tmp_path / "table.md").read_text().splitlines() if "nerf" in line]
    assert rows == ["| ball | zipnerf | **20.00 ± 0.00** |", "|  | surfnerf | **20.00 ± 0.00** |"]


def test_a_sweep_is_resumed_with_the_same_settings_only(
    ball_scene: tuple[Scene, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, no_cache: None
) -> None:
    monkeypatch.setattr(Job, "run", stub)
    scene, out = str(ball_scene[1]), tmp_path / "sweep"
    ask = lambda *request, where=scene: sweep.run(sweep.plan([where], *request, out), out)  # noqa: E731
    ask(["zipnerf"], "fast", [], 5.0)
    with pytest.raises(UsageError, match=r"started with other settings \(budget_s was 5\.0, and is 3\.0 now\)"):
        ask(["zipnerf"], "fast", [], 3.0)
    with pytest.raises(UsageError, match=r"overrides was nothing, and is scale=0\.5 now"):
        ask(["surfnerf"], "fast", ["scale=0.5"], 5.0)
    elsewhere = tmp_path / "ball"
    shutil.copytree(ball_scene[1], elsewhere)
    with pytest.raises(UsageError, match=r"scenes\.ball was"):
        ask(["zipnerf"], "fast", [], 5.0, where=str(elsewhere))
    assert not (out / "ball/surfnerf").exists(), "refused before any training"
    assert ask(["surfnerf"], "fast", [], 5.0) == {"out": str(out), "runs": 2, "trained": 1, "table": str(out / "table.md")}
    table = (out / "table.md").read_text()
    assert "zipnerf" in table and "surfnerf" in table, "models can be added"
    (tmp_path / "other").mkdir()
    (tmp_path / "other/notes.txt").write_text("mine")
    with pytest.raises(UsageError, match="already exists"):
        sweep.run(sweep.plan([scene], ["zipnerf"], "fast", [], 5.0, tmp_path / "other"), tmp_path / "other")


def test_wrong_requests_are_named(ball_scene: tuple[Scene, Path], tmp_path: Path) -> None:
    scene = str(ball_scene[1])
    with pytest.raises(UsageError, match="did you mean 'zipnerf'"):
        sweep.plan([scene], ["zipnrf"], "fast", [], None, tmp_path)
    with pytest.raises(UsageError, match="two scenes have the same name"):
        sweep.plan([scene, scene], ["zipnerf"], "fast", [], None, tmp_path)


def test_relative_paths_are_those_of_the_first_working_directory(
    ball_scene: tuple[Scene, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, no_cache: None
) -> None:
    monkeypatch.setattr(Job, "run", stub)
    monkeypatch.chdir(tmp_path)
    scene = os.path.relpath(ball_scene[1])
    (job,) = wanted = sweep.plan([scene], ["surfnerf"], "fast", [], None, Path("sweep"))
    assert job.path == tmp_path / "sweep/ball/surfnerf/seed_0" and job.recipe.scene == str(ball_scene[1])
    result = sweep.run(wanted, Path("sweep"))
    assert result == {"out": str(tmp_path / "sweep"), "runs": 1, "trained": 1, "table": str(tmp_path / "sweep/table.md")}
    monkeypatch.chdir("/")
    out = tmp_path / "sweep"
    assert sweep.run(sweep.plan([str(ball_scene[1])], ["surfnerf"], "fast", [], None, out), out) == result | {"trained": 0}


def test_without_ray_its_extra_is_named(ball_scene: tuple[Scene, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "koala3d.reconstruct.studies.on_ray", raising=False)
    with pytest.raises(ModuleNotFoundError) as caught:
        sweep.run(sweep.plan([str(ball_scene[1])], ["zipnerf"], "fast", [], None, tmp_path), tmp_path, use_ray=True)
    assert str(not_installed(caught.value)) == "ray is not installed; pip install 'koala-capture[sweep]'"
