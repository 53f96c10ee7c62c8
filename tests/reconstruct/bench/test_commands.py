"""The commands parse, refuse what they cannot take, and say what they will do."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.bench.records import Records
from koala3d.reconstruct.bench.runner import RECORDS
from koala3d.reconstruct.cli import app


def invoke(*words: str | Path):
    return CliRunner().invoke(app, ["bench", *map(str, words)])


def test_the_plan_trains_nothing() -> None:
    told = json.loads(invoke("--plan", "--json").stdout)
    assert len(told["trials"]) == 14 and told["training_s"] == 245


def test_out_is_needed_and_names_are_checked(tmp_path: Path) -> None:
    assert isinstance(invoke().exception, UsageError)
    assert "did you mean 'quick'" in str(invoke("--suite", "quik", "--out", tmp_path).exception)
    assert "no such file" in str(invoke("--peer", tmp_path / "none.csv", "--out", tmp_path).exception)


def test_two_benchmarks_are_compared(tmp_path: Path, make_row: Callable) -> None:
    for name, gain in (("a", 0.0), ("b", 1.0)):
        for seed in range(3):
            Records(tmp_path / name / RECORDS).append(make_row(seed=seed, psnr=25 + gain + 0.05 * seed))
    told = json.loads(invoke("compare", tmp_path / "a", tmp_path / "b", "--json").stdout)
    assert {row["figure"]: row["verdict"] for row in told["differences"]}["psnr"] == "better"
    assert "better" in invoke("compare", tmp_path / "a", tmp_path / "b").stdout
    with pytest.raises(UsageError, match="holds no benchmark"):
        raise invoke("compare", tmp_path / "a", tmp_path / "none").exception
