"""`reconstruct bench gpu`: what it trains, what it does without a GPU, and the command itself on a processor."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.bench import runner
from koala3d.reconstruct.bench.gpu import run
from koala3d.reconstruct.bench.gpu.plan import LARGE, LEGO, SECONDS, Sizes, trials
from koala3d.reconstruct.bench.scenes import make
from koala3d.reconstruct.cli import app

CPU = {"platform": "cpu", "devices": 1, "text": "cpu: compiled kernels"}
TWO = {"platform": "gpu", "devices": 2, "text": "2 x a card"}


def test_trainings_take_their_share_of_ten_minutes() -> None:
    full = trials(Sizes.on("gpu", None))
    assert sum(one.budget_s for one in full) <= SECONDS and {one.preset for one in full} == {"fast", "paper"}
    assert [one.budget_s for one in full if one.scene == LEGO and one.preset == "fast"] == [11.25, 22.5, 45]
    assert {one.scene for one in full} == {LEGO, LARGE} and Sizes.on("gpu", None).side == 800
    assert sum(one.budget_s for one in trials(Sizes.on("gpu", 18.0))) == pytest.approx(sum(o.budget_s for o in full) / 10)


def test_without_a_gpu_one_line_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(run, "device", lambda: CPU)
    told = CliRunner().invoke(app, ["bench", "gpu", "--out", str(tmp_path / "out")]).exception
    assert isinstance(told, UsageError) and "no GPU" in str(told) and "--seconds" in str(told) and "\n" not in str(told)
    assert not (tmp_path / "out").exists()


def test_what_is_done_is_not_done_again_and_one_device_is_seen_alone(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, make_row: Callable
) -> None:
    asked: list[tuple[str, str | None]] = []

    def pretend(one, place, folder, settings, **environment) -> dict[str, Any]:
        asked.append((one.name, environment.get("CUDA_VISIBLE_DEVICES")))
        return make_row(**vars(one), width=8.0, height=8.0, train_views=6.0, seconds=0.1)

    monkeypatch.setattr(runner, "measure", pretend)
    monkeypatch.setattr(run, "_command", lambda *words: "")
    monkeypatch.setattr(run, "step_plans", lambda sizes: [])
    (tmp_path / "data" / LEGO).mkdir(parents=True)
    sizes = Sizes.on("gpu", 10.0)
    found = run.measure(TWO, sizes, tmp_path / "out", tmp_path / "data")
    assert [alone for _, alone in asked] == [None] * len(trials(sizes)) + ["0"] * len(trials(sizes, alone=True))
    assert len(found["alone"]) == 2 and "one of these devices" in run.text(found)
    run.measure(TWO, sizes, tmp_path / "out", tmp_path / "data")
    assert len(asked) == len(set(asked)), "the second time nothing is measured"


@pytest.mark.slow
def test_the_command_on_a_processor(tmp_path: Path) -> None:
    """Nothing is optimised, and everything is small; the second time nothing is left to do."""
    make.write("chrome_ball", tmp_path / "data" / LEGO, size=64, train=6, test=2)
    out, environment = (
        tmp_path / "out",
        {"XLA_FLAGS": "--xla_backend_optimization_level=0", "KOALA_CACHE": str(tmp_path / "cache")},
    )
    words = ["bench", "gpu", "--seconds", "0.5", "--out", str(out), "--data", str(tmp_path / "data"), "--json"]
    command = [sys.executable, "-c", "from koala3d.reconstruct.cli import main; main()", *words]
    for _ in range(2):
        done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=True)
        found = json.loads(done.stdout.strip().splitlines()[-1])
        assert found["device"]["platform"] == "cpu" and found["failed"] == 0 and not found["absent"]
        assert {(row["scene"], row["preset"]) for row in found["rows"]} == {(LEGO, "fast"), (LARGE, "fast"), (LEGO, "paper")}
        assert all(row["rays_per_s"] > 0 and row["seconds"] > 0 for row in found["rows"]) and found["plans"]
    assert (out / "index.html").is_file() and (out / "records.csv").read_text().count("\n") == 4
