"""`reconstruct asset --robot` on a run: what it writes stands in MuJoCo, and misuse is one line."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
import pytest

from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.cli import main
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.run import CHECKPOINTS, Run
from koala3d.reconstruct.training.step import Step

BLOCK = np.array([0.5, 0.4, 0.6])
"""Half the sides of the block that is solid, in halves of the object's box, 0.2 m wide."""


@pytest.fixture
def config(small_config: Config) -> Config:
    """Of a field that is dense all over."""
    return load_config(overrides=["encoding.levels=2", "encoding.log2_size=8", "field.spatial_width=8", "field.view_width=8",
                                  "sampler.grid=32", "field.density_bias=8"])  # fmt: skip


@pytest.fixture
def run(make_run: Callable[..., Run], config: Config) -> Path:
    """A run with fresh weights, whose occupancy grid leaves a block of its dense field."""
    made = make_run(config, checkpointed=False)
    axis = (np.arange(config.sampler.grid) + 0.5) / config.sampler.grid * 2 - 1
    inside = np.stack([np.abs(c) for c in np.meshgrid(axis, axis, axis, indexing="ij")], -1) < BLOCK
    state = Step.of(config, made.facts).initial(jax.random.key(0), inside.all(-1).reshape(-1))
    checkpoint.save(made.path / CHECKPOINTS, state, {"seconds": 2.0, "step": 0.0})
    return made.path


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Run the command inside this process; returns exit code, output and errors."""
    monkeypatch.setattr("koala3d.reconstruct.backend.configure_process", lambda: None)

    def call(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["reconstruct", "asset", *map(str, words)])
        with pytest.raises(SystemExit) as stop:
            main()
        captured = capsys.readouterr()
        return int(stop.value.code or 0), captured.out, captured.err

    return call


def test_a_run_becomes_a_body_that_stands(command: Callable[..., tuple[int, str, str]], run: Path, tmp_path: Path) -> None:
    for name in ("coacd", "xatlas"):
        pytest.importorskip(name, reason=f"{name} is absent: pip install 'koala-capture[asset]'")
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is absent: pip install 'koala-capture[test]'")
    out = tmp_path / "block"
    code, text, err = command(run, "--robot", "mjcf", "--out", out, "--mass", 0.3, "--texture", 64, "--faces", 1000,
                              "--resolution", 32, "--json")  # fmt: skip
    assert code == 0, err
    found = json.loads(text)
    assert found["mass_kg"] == pytest.approx(0.3) and found["measured_in"] == "the closed mesh"
    wider = 2 * 0.2 / 32  # the field is sampled one cell around those that are occupied
    assert found["volume_m3"] == pytest.approx(np.prod(0.2 * BLOCK + wider), rel=0.1)
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    before = data.xpos[1].copy()
    while data.time < 2:
        mujoco.mj_step(model, data)
    assert np.linalg.norm(data.xpos[1] - before) < 1e-3 and data.xmat[1].reshape(3, 3)[2, 2] > np.cos(np.deg2rad(0.5))
    assert np.abs(data.qvel).max() < 1e-3


def test_misuse_is_one_line(command: Callable[..., tuple[int, str, str]], run: Path, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "new")
    cases = {
        (run, *out, "--robot", "sdf", "--mass", 1): "there is no robot format 'sdf'; valid: mjcf, urdf",
        (run, *out, "--robot", "urdf"): "needs either a mass or a density (neither was given)",
        (run, *out, "--robot", "urdf", "--mass", 1, "--density", 1): "(both were given)",
        (run, *out, "--robot", "urdf", "--mass", 1, "--open"): "--light and --open are not for --robot",
        (run, *out, "--mass", 1): "--mass and --density are for --robot",
        (run, "--out", run, "--robot", "urdf", "--mass", 1): "already exists",
    }
    for words, expected in cases.items():
        code, text, err = command(*words)
        assert code == 2 and not text and expected in " ".join(err.split()), (words, err)
        assert not (tmp_path / "new").exists()
