"""The command as a person meets it: output, exit codes 0, 1 and 2, one line on errors."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import trimesh

from koala3d.reconstruct.cli import main
from koala3d.reconstruct.models import names
from koala3d.reconstruct.run import Run


@pytest.fixture
def command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Callable[..., tuple[int, str, str]]:
    """Run the command inside this process; returns exit code, output and errors."""
    monkeypatch.setattr("koala3d.reconstruct.backend.configure_process", lambda: None)

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["reconstruct", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            main()
        captured = capsys.readouterr()
        return int(stop.value.code or 0), captured.out, captured.err

    return run


def test_eval_render_mesh_and_report_of_a_run(
    command: Callable[..., tuple[int, str, str]], make_run: Callable[..., Run], tmp_path: Path
) -> None:
    run = make_run().path
    code, out, _ = command("eval", run)
    assert code == 0 and "2 test views at 48x40" in out and "PSNR [dB]" in out and "normals, weighted by opacity [deg]" in out
    code, out, _ = command("render", run, "--out", tmp_path / "renders", "--json")
    assert code == 0 and json.loads(out)["views"] == 2 and (tmp_path / "renders/rgb/000.png").is_file()
    code, out, _ = command("mesh", run, "--out", tmp_path / "mesh.ply", "--resolution", 24, "--level", 0.02, "--json")
    assert code == 0 and len(trimesh.load_mesh(tmp_path / "mesh.ply").faces) == json.loads(out)["faces"]
    code, out, _ = command("report", run, "--out", tmp_path / "report")
    assert code == 0 and out.strip() == str(tmp_path / "report/index.html")
    for arguments in (("render", run, "--out", tmp_path / "renders"), ("mesh", run, "--out", tmp_path / "mesh.ply"),
                      ("report", run, "--out", tmp_path / "report")):  # fmt: skip
        code, out, err = command(*arguments)
        assert code == 2 and "already exists" in err and not out


def test_light_is_refused_before_anything_is_computed(
    command: Callable[..., tuple[int, str, str]], make_run: Callable[..., Run], tmp_path: Path
) -> None:
    run = make_run().path
    code, _, err = command("light", run, "--out", tmp_path / "light.png")
    assert code == 2 and "light is not written as '.png'" in err
    (tmp_path / "light.exr").write_text("here")
    code, _, err = command("asset", run, "--out", tmp_path / "a.glb", "--light", tmp_path / "light.exr")
    assert code == 2 and "already exists" in err and not (tmp_path / "a.glb").exists()
    code, _, err = command("eval", run, "--asset", tmp_path / "a.glb", "--light", tmp_path / "light.exr")
    assert code == 1 and "there is no such asset" in err


def test_misuse_is_one_line(command: Callable[..., tuple[int, str, str]], make_run: Callable[..., Run], tmp_path: Path) -> None:
    run = make_run().path
    cases = {
        ("eval", tmp_path / "nothing"): "is not a run",
        ("eval",): "give either a run, or --renders DIR --scene SCENE",
        ("eval", run, "--renders", tmp_path): "give either a run",
        ("eval", run, "--lpips", tmp_path / "none.npz"): "no such file",
        ("train", tmp_path): "give the folder of the run: --out DIR",
        ("train", "--out", tmp_path / "r"): "give either a scene, or --from RUN --finetune",
        ("train", "--out", tmp_path / "r", "--from", run): "give either a scene, or --from RUN --finetune",
        ("table", run): "has not been evaluated",
        ("render", run, "--out", tmp_path / "film.avi", "--fps", 10): "end --out in .mp4",
        ("sweep", "--scene", tmp_path / "none", "--out", tmp_path / "r"): "no such scene",
        ("sweep", "--out", tmp_path / "r", "--scene", tmp_path, "--model", "surfnrf"): "did you mean 'surfnerf'",
        ("eval", run, "--split", "val"): "scene has no val views",
        ("eval", run, "--splat", "val"): "there is no option '--splat'; did you mean '--split'",
        ("mesh", run, "--out", tmp_path / "mesh.stl"): "end --out in .ply, .glb, .obj",
        ("mesh", run, "--out", tmp_path / "mesh.ply", "--resolution", "5"): "Invalid value",
        ("mesh", run, "--out", tmp_path / "mesh.ply", "--stands-on", "-w"): "there is no side '-w' of the box; one of -x, +x",
        ("report", run, "--out", tmp_path / "r", "--calibration", tmp_path / "none.json"): "no such file",
    }
    before = sorted(tmp_path.iterdir())
    for arguments, message in cases.items():
        code, out, err = command(*arguments)
        errors = [line for line in err.splitlines() if line.startswith("error: ")]
        assert code == 2 and not out and len(errors) == 1 and message in errors[0] and "Traceback" not in err, arguments
    assert sorted(tmp_path.iterdir()) == before


def test_a_scene_that_is_gone_is_named(
    command: Callable[..., tuple[int, str, str]], make_run: Callable[..., Run], tmp_path: Path
) -> None:
    run = make_run()
    text = (run.path / "run.json").read_text().replace(run.scene_path, str(tmp_path / "gone"))
    (run.path / "run.json").write_text(text)
    code, _, err = command("eval", run.path)
    assert code == 2 and "gone" in err and "no such scene" in err


def test_models_are_listed_with_their_parts(command: Callable[..., tuple[int, str, str]]) -> None:
    code, out, _ = command("models")
    lines = out.splitlines()
    assert (
        code == 0
        and len(lines) == 1 + len(names())
        and lines[0].split() == ["model", "encoding", "appearance", "regularisers", "about"]
    )
    assert any(line.split()[:4] == ["zipnerf", "voxels", "view", "-"] for line in lines)
    code, out, _ = command("models", "--json")
    assert code == 0 and {row["name"] for row in json.loads(out)["models"]} >= {"surfnerf", "mipnerf", "finetune"}


def test_the_backend_is_one_line(command: Callable[..., tuple[int, str, str]], monkeypatch: pytest.MonkeyPatch) -> None:
    code, out, _ = command("backend")
    assert code == 0 and len(out.splitlines()) == 1
    monkeypatch.setenv("KOALA_KERNELS", "off")
    code, out, _ = command("backend")
    assert code == 0 and "plain JAX, for KOALA_KERNELS=off" in out and len(out.splitlines()) == 1
    code, out, _ = command("backend", "--json")
    assert code == 0 and json.loads(out)["kernels"] is False


def test_settings_are_listed_with_the_defaults_of_the_model_and_preset(command: Callable[..., tuple[int, str, str]]) -> None:
    code, out, _ = command("train", "--list-settings", "--model", "zipnerf", "--set", "scale=0.5")
    lines = out.splitlines()
    assert code == 0 and lines[0].split() == ["key", "type", "default", "meaning"]
    assert any(line.split()[:3] == ["encoding.kind", "lattice|voxels|frequencies", "voxels"] for line in lines)
    code, out, _ = command("train", "--list-settings", "--json")
    rows = {row["key"]: row for row in json.loads(out)["settings"]}
    assert code == 0 and rows["train.rate"]["type"] == "float > 0" and rows["encoding.kind"]["default"] == "lattice"


def test_measured_runs_become_a_table(
    command: Callable[..., tuple[int, str, str]], make_run: Callable[..., Run], tmp_path: Path
) -> None:
    run = make_run(checkpointed=False).path
    content = {"format": "koala-metrics", "version": 1, "mean": {"psnr": 21.0, "ssim": 0.5}, "per_view": []}
    (run / "metrics.json").write_text(json.dumps(content))
    code, out, _ = command("table", run, "--out", tmp_path / "table.csv", "--column", "psnr")
    assert code == 0 and "| ball | surfnerf | 21.00 |" in out and (tmp_path / "table.csv").read_text().endswith("surfnerf,21.0\n")
