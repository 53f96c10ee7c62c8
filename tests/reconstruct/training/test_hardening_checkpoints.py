"""Checkpoints survive kills, flipped bits and full disks: what was complete before is used, and it is said."""

import os
import shutil
from collections import namedtuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.scene import Scene
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.models import merged_config
from koala3d.reconstruct.run import CHECKPOINTS, Run
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.training.loop import start, train

State = namedtuple("State", ["step", "weights"])
"""Stands for a training state: checkpoints take any tree with a step."""


def state(step: int, size: int = 1000) -> Any:
    return State(np.int32(step), np.random.default_rng(step).normal(size=size).astype(np.float32))


def saved(folder: Path) -> list[Path]:
    """Two checkpoints."""
    for step in (1, 2):
        checkpoint.save(folder, state(step), {"seconds": float(step)})
    return checkpoint.steps(folder)


def flips(folder: Path) -> list[tuple[Path, int]]:
    """Some bits of every file, each as file and number of the bit."""
    choice = np.random.default_rng(0)
    found = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.stat().st_size]
    return [(path, int(bit)) for path in found for bit in choice.integers(0, 8 * path.stat().st_size, 12)]


def flip(path: Path, bit: int) -> None:
    data = bytearray(path.read_bytes())
    data[bit // 8] ^= 1 << bit % 8
    path.write_bytes(data)


def test_a_flipped_bit_in_the_newest_checkpoint_is_noticed_and_the_one_before_is_used(tmp_path: Path, capsys) -> None:
    _, newest = saved(tmp_path / "sound")
    wrong = []
    for path, bit in flips(newest):
        shutil.rmtree(tmp_path / "broken", ignore_errors=True)
        shutil.copytree(tmp_path / "sound", tmp_path / "broken")
        flip(tmp_path / "broken" / path.relative_to(tmp_path / "sound"), bit)
        name = f"{path.relative_to(newest)}, bit {bit}"
        try:
            loaded, clock = checkpoint.load(tmp_path / "broken", state(0))
        except Exception as error:
            wrong.append(f"{name}: {type(error).__name__}: {str(error)[:80]}")
            continue
        step = int(loaded.step)
        if step not in (1, 2) or not np.array_equal(loaded.weights, state(step).weights) or clock["seconds"] != step:
            wrong.append(f"{name}: step {step} with wrong numbers")
        elif step == 1 and "00000002" not in capsys.readouterr().err:
            wrong.append(f"{name}: step 1 without a word")
    assert not wrong, f"{len(wrong)} of {len(flips(newest))}: {wrong[:5]}"


@pytest.mark.parametrize("both", [False, True])
def test_a_checkpoint_without_a_file_is_passed_over_or_refused_in_one_line(tmp_path: Path, both: bool) -> None:
    for folder in saved(tmp_path)[0 if both else 1 :]:
        largest = max((path for path in folder.rglob("*") if path.is_file()), key=lambda path: path.stat().st_size)
        largest.unlink()
    if both:
        with pytest.raises(KoalaError, match="checkpoint"):
            checkpoint.load(tmp_path, state(0))
    else:
        assert int(checkpoint.load(tmp_path, state(0))[0].step) == 1


@pytest.mark.usefixtures("two_steps_at_once")
def test_a_training_killed_before_its_first_checkpoint_is_started_over_by_resume(
    ball_scene: tuple[Scene, Path], small_config: Config, tmp_path: Path
) -> None:
    config = merged_config(small_config, {"train": {"steps": 2}})
    start(*ball_scene, config, tmp_path / "run")  # and no more: the process is killed here
    assert Run.open(tmp_path / "run").path.is_dir() and not (tmp_path / "run" / CHECKPOINTS).exists()
    result = train(*ball_scene, config, tmp_path / "run", resume=True)
    assert result["steps"] == 2 and checkpoint.steps(tmp_path / "run" / CHECKPOINTS)


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return Run.create(tmp_path / "run", Config(), tmp_path, SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.1, 2.0)), {})


@pytest.mark.parametrize("rest", [b'{"step": 2, "sec', bytes(300)], ids=["cut", "zeros"])
def test_a_log_goes_on_after_a_line_that_was_cut_off(run: Run, rest: bytes) -> None:
    run.append_log({"step": 1})
    with open(run.path / "log.jsonl", "ab") as file:
        file.write(rest)
    run.append_log({"step": 3})
    assert [line["step"] for line in run.log()] == [1, 3]


@pytest.mark.parametrize("damage", [b"not json\n", b"\xff\xfe\n"], ids=["words", "bytes"])
def test_a_damaged_log_is_one_line(run: Run, damage: bytes) -> None:
    (run.path / "log.jsonl").write_bytes(b'{"step": 1}\n' + damage + b'{"step": 2}\n')
    with pytest.raises(KoalaError, match=r"log\.jsonl, line 2"):
        run.log()


def fill(disk: Path, left: int) -> Path:
    """Fill a disk up to some bytes; returns the file that does it."""
    path = disk / "filling"
    path.write_bytes(bytes(max(shutil.disk_usage(disk).free - left, 0)))
    return path


def test_a_full_disk_amid_a_checkpoint_loses_none_that_was_complete(small_disk: Path) -> None:
    checkpoint.save(small_disk / "run", state(1, 20_000), {"seconds": 1.0})
    filling = fill(small_disk, 60_000)
    with pytest.raises((OSError, KoalaError)) as full:
        checkpoint.save(small_disk / "run", state(2, 20_000), {"seconds": 2.0})
    assert "No space left" in str(full.value) or "disk is full" in str(full.value)
    assert int(checkpoint.load(small_disk / "run", state(0, 20_000))[0].step) == 1
    filling.unlink()
    checkpoint.save(small_disk / "run", state(2, 20_000), {"seconds": 2.0})
    assert int(checkpoint.load(small_disk / "run", state(0, 20_000))[0].step) == 2
    assert sorted(path.name for path in (small_disk / "run").iterdir()) == ["00000001", "00000002"], (
        "nothing half-written is left"
    )


def test_a_full_disk_amid_a_line_of_the_log_loses_none_that_was_complete(small_disk: Path) -> None:
    run = Run.create(
        small_disk / "run", Config(), small_disk, SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.1, 2.0)), {}
    )
    page = os.sysconf("SC_PAGE_SIZE")
    run.append_log({"step": 1, "words": "x" * (page - 100)})
    filling = fill(small_disk, 0)
    with pytest.raises(OSError, match="No space left"):
        run.append_log({"step": 2, "words": "x" * page})
    filling.unlink()
    run.append_log({"step": 3})
    assert [line["step"] for line in run.log()] == [1, 3]


def test_a_training_without_room_for_its_checkpoints_is_refused_before_it_begins(
    ball_scene: tuple[Scene, Path], small_config: Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: type(usage)(usage.total, usage.total - 1000, 1000))
    with pytest.raises(KoalaError, match=r"room|free"):
        start(*ball_scene, small_config, tmp_path / "run")
