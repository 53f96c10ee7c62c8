"""NerfBaselines' own checks of a method. KOALA_NERFBASELINES names a Python that has it and Koala, see docs/exports.md."""

import json
import os
import subprocess
from pathlib import Path

import pytest

from koala3d.datasets.formats import save_scene
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.benchmark import method

SPEC = Path(method.__file__).with_name("spec.py")
LOADER = "nerfbaselines.datasets.blender:load_blender_dataset"
BACKBONE = (
    "import sys, torch, torchvision; torch.manual_seed(0); "
    "torch.save(torchvision.models.alexnet(weights=None).state_dict(), sys.argv[1])"
)
"""LPIPS's network with random weights, which the checks only compare with themselves: real ones would be downloaded."""
SETTINGS = ("encoding.log2_size=8", "sampler.rays=256", "train.steps=100")


@pytest.mark.timeout(900)
def test_its_checks_pass(ball_scene: tuple[Scene, Path], tmp_path: Path) -> None:
    python = os.environ.get("KOALA_NERFBASELINES")
    if not python:
        pytest.skip("KOALA_NERFBASELINES is not set: name the Python of an environment with NerfBaselines and Koala")
    save_scene(ball_scene[0], tmp_path / "scene", "blender")
    about = {"loader": LOADER, "evaluation_protocol": "default", "id": None, "scene": None}
    (tmp_path / "scene" / "nb-info.json").write_text(json.dumps(about))
    network = tmp_path / "torch" / "hub" / "checkpoints" / "alexnet-owt-7be5be79.pth"
    network.parent.mkdir(parents=True)
    subprocess.run([python, "-c", BACKBONE, network], check=True, capture_output=True, timeout=200)
    environment = {**os.environ, "NERFBASELINES_REGISTER": str(SPEC), "TORCH_HOME": str(tmp_path / "torch")}
    words = [word for setting in SETTINGS for word in ("--set", setting)]
    command = [Path(python).with_name("nerfbaselines"), "test-method", "--method", "koala", "--data", tmp_path / "scene"]
    options = ["--backend", "python", "--steps", "20", *words]
    done = subprocess.run([*command, *options], env=environment, capture_output=True, text=True, timeout=800, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    for passed in ("Train iteration passes", "Resaving method yields same checkpoint", "Checkpoint reproduces results"):
        assert f"✓ {passed}" in done.stderr + done.stdout
    assert "✗" not in done.stderr + done.stdout
