"""The bookkeeping of studies; the trainings are stubs."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.run import Run
from koala3d.reconstruct.studies import ablate, jobs


def test_the_grid_changes_one_thing_at_a_time() -> None:
    cells = ablate.grid(load_config())
    assert cells["base"] == () and "sampling lattice" not in cells and "k = 3" not in cells
    forms = {"sampling fibonacci", "sampling random", "k = 5", "every 2048/16", "every 512/4", "solid density", "tangent density"}
    without = {
        "published density",
        "without hollowness",
        "without normal",
        "without bias",
        "without variation",
        "no second pass",
        "no regulariser",
    }
    assert forms | without <= set(cells)
    assert cells["without bias"] == ("surface.bias=0",)
    off = ablate.grid(load_config(overrides=["surface.bias=0"]))
    assert off["with bias"] == ("surface.bias=0.03",), "what is off is tried with its published weight"
    base = load_config()
    for name, changes in cells.items():
        changed = load_config(overrides=list(changes))
        assert (changed.surface == base.surface and changed.losses == base.losses) == (name == "base"), name


def test_folders_of_cells_are_different() -> None:
    cells = ablate.grid(load_config())
    assert len({ablate.folder_name(name) for name in cells}) == len(cells)
    assert all("/" not in ablate.folder_name(name) for name in cells)


@pytest.fixture
def trainings(monkeypatch: pytest.MonkeyPatch, ball_scene: tuple[Scene, Path]) -> list[str]:
    """Stubs that record the trainings; that of `random` is interrupted once."""
    done: list[str] = []

    def train(scene: Scene, scene_path: Path, config: Any, out: Path, **options: Any) -> None:
        name = f"{out.parent.name}/{out.name}"
        done.append(name)
        assert config.train.seed == int(out.name.removeprefix("seed_"))
        if name == "sampling_random/seed_3" and done.count(name) == 1:
            raise KeyboardInterrupt
        run = {"format": "koala-run", "version": 1, "scene": str(scene_path), "scene_name": "ball",
               "config": config.model_dump(mode="json"),
               "normalisation": {"centre": [0.0, 0.0, 0.0], "scale": 1.0, "bounded": True, "near": 0.1, "far": 2.0}}  # fmt: skip
        out.mkdir(parents=True)
        (out / "run.json").write_text(json.dumps(run))

    def evaluate(path: Path) -> None:
        mean = {"psnr": 20.0 + len(done), "normal_mae_alpha_acc_deg": 30.0 - len(done)}
        (path / "metrics.json").write_text(json.dumps({"format": "koala-metrics", "version": 1, "mean": mean, "per_view": []}))

    monkeypatch.setattr(jobs, "train", train)
    monkeypatch.setattr(jobs.TrainedModel, "open", lambda path: path)
    monkeypatch.setattr(jobs, "evaluate", evaluate)
    return done


def test_an_interrupted_study_is_resumed(trainings: list[str], ball_scene: tuple[Scene, Path], tmp_path: Path) -> None:
    study = ablate.plan(str(ball_scene[1]), "surfnerf", "fast", ["train.seed=3"], 5.0, ["sampling random", "k = 1"])
    assert list(study.cells) == ["base", "sampling random", "k = 1"]
    with pytest.raises(KeyboardInterrupt):
        ablate.run(study, tmp_path / "study")
    result = ablate.run(study, tmp_path / "study")
    assert trainings == [f"{name}/seed_3" for name in ("base", "sampling_random", "sampling_random", "k_1")], "finished runs stay"
    assert [row["cell"] for row in result["rows"]] == ["base", "sampling random", "k = 1"]
    table = (tmp_path / "study/table.md").read_text()
    assert "| ball | base | 21.00 | 29.00 |" in table, table
    assert "**24.00** | **26.00**" in table
    assert {p.name for p in (tmp_path / "study").iterdir()} == {
        "cells",
        "study.json",
        "table.md",
        "table.csv",
        "table.tex",
        "figure.png",
        "index.html",
    }
    page = (tmp_path / "study/index.html").read_text()
    named = "--budget 5 --set train.seed=3 --seed 3 --cell &#39;sampling random&#39; --cell &#39;k = 1&#39; --out"
    assert named in page, "the command makes these cells, not all"
    assert "<td>sampling random</td>" in page and "surface.neighbours=1" in page
    more = ablate.plan(str(ball_scene[1]), "surfnerf", "fast", ["train.seed=3"], 5.0, ["k = 5"])
    assert ablate.run(more, tmp_path / "study")["cells"] == 4 and trainings[-1] == "k_5/seed_3", "cells can be added"
    other = ablate.plan(str(ball_scene[1]), "surfnerf", "fast", ["train.seed=4"], 5.0, [])
    with pytest.raises(UsageError, match=r"started with other settings.*overrides was train.seed=3, and is train.seed=4 now"):
        ablate.run(other, tmp_path / "study")


def test_seeds_can_be_added_and_make_means_with_deviations(
    trainings: list[str], ball_scene: tuple[Scene, Path], tmp_path: Path
) -> None:
    ask = lambda *seeds: ablate.plan(str(ball_scene[1]), "surfnerf", "fast", [], 5.0, ["k = 1"], seeds)  # noqa: E731
    first = ablate.run(ask(0), tmp_path / "study")
    assert first["rows"][0] == {"cell": "base", "psnr": 21.0, "normal_mae_alpha_acc_deg": 29.0}
    assert "One seed each" in (tmp_path / "study/index.html").read_text()
    both = ablate.run(ask(0, 1), tmp_path / "study")
    assert trainings == ["base/seed_0", "k_1/seed_0", "base/seed_1", "k_1/seed_1"]
    assert both["rows"][0] == {"cell": "base", "psnr": 22.0, "psnr_std": 2**0.5, "normal_mae_alpha_acc_deg": 28.0,
                               "normal_mae_alpha_acc_deg_std": 2**0.5, "seeds": 2}  # fmt: skip
    table = (tmp_path / "study/table.md").read_text()
    assert "| ball | base | 22.00 ± 1.41 | 28.00 ± 1.41 |" in table and "mean ± standard deviation over 2 seeds" in table
    page = (tmp_path / "study/index.html").read_text()
    assert "--seed 0 --seed 1 --cell" in page and "95 % confidence" in page and "22.0 ± 1.4" in page


def test_wrong_requests_are_named(ball_scene: tuple[Scene, Path], make_run: Callable[..., Run]) -> None:
    with pytest.raises(UsageError, match="did you mean 'k = 5'"):
        ablate.plan(str(ball_scene[1]), "surfnerf", "fast", [], None, ["k=5"])
    with pytest.raises(UsageError, match="a seed is given twice"):
        ablate.plan(str(ball_scene[1]), "surfnerf", "fast", [], None, [], [1, 2, 1])
    with pytest.raises(UsageError, match="already exists"):
        ablate.run(ablate.plan(str(ball_scene[1]), "surfnerf", "fast", [], None, []), make_run(checkpointed=False).path)
