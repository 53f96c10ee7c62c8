"""Kill -9 at random moments of a training: after `--resume` it ends at the same bits as an undisturbed one."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.scene import Scene
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.run import CHECKPOINTS, RUN, Run

KILLS, STEPS = 20, 1600
SETTINGS = (
    "encoding.levels=2",
    "encoding.log2_size=8",
    "field.spatial_width=8",
    "field.view_width=8",
    "sampler.grid=32",
    "sampler.rays=128",
    "sampler.samples=2048",
    "surface.rays=16",
    "train.checkpoint_s=0.2",
    f"train.steps={STEPS}",
)


def command(scene: Path, out: Path) -> list[str]:
    settings = [word for setting in SETTINGS for word in ("--set", setting)]
    return [sys.executable, "-m", "koala3d.reconstruct.cli", "train", str(scene), "--out", str(out), *settings]


def killed(words: list[str], out: Path, wait_s: float, *, training: bool) -> bool:
    """Run a command and kill it after `wait_s`, counted from its first new checkpoint with `training`; False where it ended."""
    before = checkpoint.steps(out / CHECKPOINTS)
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        while training and process.poll() is None and checkpoint.steps(out / CHECKPOINTS) == before:
            time.sleep(0.002)
        try:
            process.wait(wait_s)
            return False
        except subprocess.TimeoutExpired:
            os.kill(process.pid, signal.SIGKILL)
            return True


def finished(words: list[str]) -> float:
    """Run a command to its end; the seconds that it took."""
    begun = time.monotonic()
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-500:]
    return time.monotonic() - begun


def content(run: Path) -> tuple[dict[str, bytes], int]:
    """The arrays of the last checkpoint, and the last step of the log, which names each step once."""
    _, stored = checkpoint._newest(run / CHECKPOINTS)
    steps = [line["step"] for line in Run.open(run).log()]
    assert steps == sorted(set(steps))
    return {name: np.asarray(array).tobytes() for name, array in stored["state"].items()}, steps[-1]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_training_killed_twenty_times_ends_at_the_same_bits(ball_scene: tuple[Scene, Path], tmp_path: Path) -> None:
    _, scene = ball_scene
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    finished(command(scene, whole))  # compiles
    seconds = finished(command(scene, tmp_path / "again"))
    rng, reached = random.Random(0), []
    while len(reached) < KILLS:
        training = len(reached) % 2 == 1
        wait_s = rng.uniform(0.0, 0.3) if training else rng.uniform(0.0, 0.8 * seconds)
        resume = ["--resume"] if broken.exists() else []
        if killed([*command(scene, broken), *resume], broken, wait_s, training=training):
            found = checkpoint.steps(broken / CHECKPOINTS)
            reached.append(int(found[-1].name) if found else -1 + (broken / RUN).exists())
        else:  # it ended first: another one is killed from its beginning on
            assert content(broken) == content(whole)
            shutil.rmtree(broken)
    print(f"killed with checkpoints at {reached}; an undisturbed training takes {seconds:.1f} s")
    assert len(set(reached)) > 5  # the premise: kills hit the training at different steps
    if broken.exists():
        finished([*command(scene, broken), "--resume"])
        assert content(broken) == content(whole)
