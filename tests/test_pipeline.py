"""The whole way at its smallest, through the commands as a person types them."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import trimesh

BOARD = """\
format: koala-trajectory
version: 1
name: board
views:
  - {kind: tilted, target: [0.40, 0.0, 0.0], distance: [0.30, 0.46], tilt_deg: [5, 40], turn_deg: [-180, 180],
     shift: [0.08, 0.06], roll_deg: [0, 90, 180, 270], count: 12}
target: {kind: charuco, squares_x: 9, squares_y: 7, square_length_m: 0.03, marker_length_m: 0.022, dictionary: DICT_5X5_100}
board: {position: [0.265, 0.105, 0.003], rotation_deg: [180, 0, 0]}
camera: {exposure_us: 10000, gain_db: 0, binning: 3, width: 640, height: 360}
"""
OBJECT = """\
format: koala-trajectory
version: 1
name: object
views:
  - {kind: hemisphere, target: [0.4, 0.0, 0.1], distance: 0.4, elevation_deg: [25, 65], azimuth_deg: [-180, 180],
     rings: 2, count: 8, roll_deg: [0, 90, 180, 270]}
split: {train: 6, test: 2}
object: {centre: [0.4, 0.0, 0.1], size: [0.2, 0.2, 0.2]}
camera: {exposure_us: 10000, binning: 4, width: 64, height: 64}
"""
SMALL = (
    "train.steps=600 encoding.levels=4 encoding.log2_size=12 sampler.grid=32 sampler.outer_grid=16 sampler.rays=256 "
    "sampler.samples=4096 surface.enabled=false field.density_bias=-1"
).split()


def run(package: str, *arguments: object) -> dict[str, Any]:
    """Run one command with --json and return what it printed."""
    code = f"from {package}.cli import main; main()"
    command = [sys.executable, "-c", code, *map(str, arguments), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.timeout(600)
def test_from_trajectory_to_measured_surface(tmp_path: Path) -> None:
    """The calibration must be as good as in the demonstration; of 600 small steps only a result is asked, not a good one."""
    (tmp_path / "board.yaml").write_text(BOARD)
    (tmp_path / "object.yaml").write_text(OBJECT)
    board, recording, calibration = tmp_path / "board", tmp_path / "recording", tmp_path / "calibration.json"
    assert run("capture", "run", tmp_path / "board.yaml", "--scene", "board", "--out", board)["frames"] == 12
    run("calib", "handeye", board, "--out", calibration)
    error = run("datasets", "truth", board, "--calibration", calibration)
    assert error["hand_eye_mm"] < 0.5 and error["hand_eye_deg"] < 0.05
    assert run("capture", "run", tmp_path / "object.yaml", "--scene", "shiny_ball", "--out", recording)["frames"] == 8
    scene = tmp_path / "koala" / "ball"
    assert run("datasets", "build", recording, "--calibration", calibration, "--out", scene)["views"]["test"] == 2
    out = tmp_path / "run"
    settings = [word for setting in SMALL for word in ("--set", setting)]
    trained = run("reconstruct", "train", scene, *settings, "--out", out)
    assert trained["steps"] == 600
    assert trained["psnr_train"] > 20, "six views of a mirror say little about others, but the training must have learned its own"
    found = run("reconstruct", "eval", out)
    assert found["views"] == 2 and 0 < found["mean"]["psnr"] < 60 and 0 < found["mean"]["normal_mae_deg"] < 180
    mesh = run("reconstruct", "mesh", out, "--out", tmp_path / "mesh.ply", "--resolution", 32, "--level", 0.01)
    surface = trimesh.load_mesh(tmp_path / "mesh.ply")
    assert len(surface.faces) == mesh["faces"] > 0
    low, high = surface.bounds
    assert (low > [0.29, -0.11, -0.01]).all() and (high < [0.51, 0.11, 0.21]).all(), "in the robot's base frame, within the box"
    run("reconstruct", "report", out, "--calibration", calibration, "--out", tmp_path / "report")
    page = (tmp_path / "report" / "index.html").read_text()
    assert "hand-eye pose, position" in page and f"{error['hand_eye_mm']:.4g}" in page


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("layout", ["blender", "llff"])
def test_exported_scenes_hold_what_the_training_needs(tmp_path: Path, layout: str, make_scene: Any) -> None:
    """The same small training on a scene and on its export ends within 0.3 dB."""
    from datasets.formats import koala

    koala.save(make_scene(count=16), tmp_path / "scene")
    run("datasets", "export", tmp_path / "scene", "--format", layout, "--out", tmp_path / "exported")
    settings = [word for setting in (*SMALL, "train.steps=300") for word in ("--set", setting)]
    reached = []
    for source in ("scene", "exported"):
        run("reconstruct", "train", tmp_path / source, *settings, "--out", tmp_path / f"run_{source}")
        reached.append(run("reconstruct", "eval", tmp_path / f"run_{source}")["mean"]["psnr"])
    assert reached[0] == pytest.approx(reached[1], abs=0.3)
