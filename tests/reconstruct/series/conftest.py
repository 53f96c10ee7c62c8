"""A series of two scenes that is quick to train, and what came of it on this machine in the end."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from koala3d.datasets.formats import koala
from koala3d.datasets.scene import Scene
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.run import CHECKPOINTS
from koala3d.reconstruct.training.pace.pause import PauseRequests
from tests.moments import until
from tests.small import SET

STEPS = 48
SHARE = 0.1
"""Of the time that a training may use until its end is near, so that nobody is too late to strike."""


@pytest.fixture(scope="session")
def two_balls(ball_scene: tuple[Scene, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a series of one scene under two names, without the true mesh: comparing it takes longer than the training."""
    folder = tmp_path_factory.mktemp("two_balls")
    for name in ("one", "two"):
        koala.save(ball_scene[0], folder / "scenes" / name)
    settings = [*SET, "surface.enabled=false", "field.density_bias=0", "train.checkpoint_s=0.001"]
    content = {"objects": ["scenes/one", "scenes/two"], "model": "mipnerf", "steps": STEPS, "settings": settings}
    (folder / "series.yaml").write_text(yaml.safe_dump({**content, "check": "none", "outputs": ["eval"]}))
    return folder / "series.yaml"


COMPILED_S = 400.0
"""Longest time until a program is compiled, on a busy machine."""


def words(file: Path, out: Path, *more: object) -> list[str]:
    """The command of a series as a process of its own."""
    return [sys.executable, "-m", "koala3d.reconstruct.cli", "series", str(file), "--out", str(out), *map(str, more)]


def in_training(run: Path) -> bool:
    """Whether a run is between its first checkpoint and its last; slows it down meanwhile."""
    PauseRequests(run).request(SHARE) if run.is_dir() else None
    saved = checkpoint.steps(run / CHECKPOINTS)
    return bool(saved) and int(saved[-1].name) < STEPS


def processes_of(folder: Path) -> list[int]:
    """Processes whose command lines or working folders name a folder."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            if str(folder) in (place / "cmdline").read_text() or str(folder) == os.readlink(place / "cwd"):
                found.append(int(place.name))
        except OSError:
            continue
    return [number for number in found if number != os.getpid()]


def figures(out: Path) -> dict[str, Any]:
    """The figures of each object, which depend on every bit of its training."""
    return {row["name"]: (row["state"], row["figures"]) for row in json.loads((out / "series.json").read_text())["objects"]}


@pytest.fixture(scope="session")
def interrupted(two_balls: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the series left after Ctrl-C in the midst of the first training, a killed driver, and the same command once more."""
    out, log = two_balls.parent / "alone", two_balls.parent / "alone/one/steps/train.log"
    driver = subprocess.Popen(words(two_balls, out), stderr=subprocess.PIPE, text=True, start_new_session=True)
    until(lambda: in_training(out / "one" / "run"), "the first checkpoint", COMPILED_S)
    os.killpg(driver.pid, signal.SIGINT)
    said = driver.communicate()[1]
    assert driver.returncode == 1 and said.endswith("error: stopped by Ctrl-C; what was finished is kept\n")
    assert "stopped by Ctrl-C" in log.read_text(), "the training was given the time to save"
    driver = subprocess.Popen(words(two_balls, out), stderr=subprocess.DEVNULL)
    until(lambda: "--resume" in log.read_text(), "the same training", COMPILED_S)
    driver.kill()
    driver.wait()
    until(lambda: not processes_of(two_balls.parent), "the end of what the driver had started")
    assert not (out / "one/steps/train.json").exists() and not (out / "two").exists()
    done = subprocess.run(words(two_balls, out), capture_output=True, text=True, timeout=1200, check=False)
    assert done.returncode == 0, done.stderr
    return out
