import json
import subprocess
import sys
from functools import partial

import pytest

from koala3d.calib.cli import main


@pytest.fixture(scope="module")
def calib(run_inside):
    """Runs the command inside this process."""
    return partial(run_inside, main, "calib")


@pytest.fixture(scope="module")
def handeye(calib, recorded, tmp_path_factory):
    """(finished command, its output file)."""
    out = tmp_path_factory.mktemp("calib") / "calibration.json"
    return calib("handeye", recorded[0], "--out", out), out


def test_handeye_writes_a_calibration_and_says_what_it_found(handeye):
    result, out = handeye
    assert result.returncode == 0, result.stderr
    assert "flange_from_camera" in result.stdout and " ± " in result.stdout and "px rms" in result.stdout
    assert "note: no target was found in view 011" in result.stdout
    assert json.loads(out.read_text())["format"] == "koala-calibration"


def test_verify_reads_it(calib, handeye, recorded):
    result = calib("verify", recorded[0], "--calibration", handeye[1], "--json")
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout)
    assert found["views"] == 11 and 0 < found["rms_mm"] < 0.5


def test_intrinsics_then_handeye_with_them(calib, recorded, tmp_path):
    first = calib("intrinsics", recorded[0], "--out", tmp_path / "camera.json", "--json")
    assert first.returncode == 0, first.stderr
    assert json.loads(first.stdout)["residuals"]["views_used"] == 11 and "flange_from_camera" not in json.loads(first.stdout)
    second = calib("handeye", recorded[0], "--intrinsics", tmp_path / "camera.json", "--out", tmp_path / "rig.json", "--json")
    assert second.returncode == 0, second.stderr
    assert len(json.loads(second.stdout)["flange_from_camera"]["translation_std_mm"]) == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["handeye", "/nowhere", "--out", "{tmp}/c.json"], "is not a recording"),
        (["handeye", "{recording}", "--out", "{tmp}"], "is a folder"),
        (["handeye", "{recording}", "--out", "{tmp}/c.json", "--intrinsics", "{tmp}/no.json"], "no such file"),
        (["handeye", "{recording}", "--out", "{tmp}/c.json", "--arm-mm", "nan"], "--arm-mm"),
        (["handeye", "{recording}"], "--out"),
        (["handeye", "{recording}", "--out", "{tmp}/c.json", "--joint-deg", "-1"], "--joint-deg"),
        (["verify", "{recording}"], "--calibration"),
        (["handeyes"], "handeyes"),
        (["handeye", "{recording}", "--out", "{tmp}/c.json", "--lens", "brawn"], "did you mean 'brown'"),
        (["compare", "{tmp}"], "is not a recording (it has no manifest.json); describe images and poses"),
        (["handeye", "{tmp}", "--import", "{tmp}/none.yaml", "--out", "{tmp}/c.json"], "no such file"),
        (["board", "--out", "{tmp}/board.png"], ".pdf or .svg"),
        (["board", "--squares", "nine", "--out", "{tmp}/board.pdf"], "squares such as 9x7"),
        (["handeye", "{recording}", "{recording}", "--intrinsics", "x.json", "--out", "{tmp}/c.json"], "--intrinsics"),
    ],
)
def test_misuse_is_one_line_and_exit_code_2(calib, recorded, tmp_path, arguments, message):
    result = calib(*(a.format(tmp=tmp_path, recording=recorded[0]) for a in arguments))
    assert result.returncode == 2
    assert message in result.stderr and len(result.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_is_not_overwritten(calib, handeye, recorded):
    before = handeye[1].read_bytes()
    result = calib("handeye", recorded[0], "--out", handeye[1])
    assert result.returncode == 2 and "already exists" in result.stderr
    assert handeye[1].read_bytes() == before


def test_joint_offsets_need_joint_angles_of_this_arm(calib, recorded, tmp_path):
    result = calib("handeye", recorded[0], "--joint-deg", "0.05", "--out", tmp_path / "c.json")
    assert result.returncode == 1 and "joint angles are not those of the poses" in result.stderr
    assert not (tmp_path / "c.json").exists()


def test_a_board_is_printed(calib, tmp_path):
    result = calib(
        "board",
        "--kind",
        "tags",
        "--squares",
        "4x3",
        "--dictionary",
        "DICT_APRILTAG_36h11",
        "--out",
        tmp_path / "b.svg",
        "--json",
    )
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["page_mm"] == [140.0, 124.0] and "<rect" in (tmp_path / "b.svg").read_text()


def test_report_is_a_page_about_a_stored_calibration(calib, handeye, recorded, tmp_path):
    before = handeye[1].read_bytes()
    result = calib("report", handeye[1], "--out", tmp_path / "page.html")
    assert result.returncode == 0, result.stderr
    assert "Two halves of the views" in (tmp_path / "page.html").read_text() and handeye[1].read_bytes() == before
    missing = calib("report", handeye[1], "--recording", tmp_path / "gone", "--out", tmp_path / "other.html")
    assert missing.returncode == 2 and "--recording" in missing.stderr and not (tmp_path / "other.html").exists()


def test_plan_writes_a_trajectory(calib, recorded, tmp_path):
    result = calib("plan", recorded[0], "--count", "3", "--grow-mm", "100", "--out", tmp_path / "next.yaml", "--json")
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout)
    assert found["after"][-1][0] < found["before"][0]
    assert (tmp_path / "next.yaml").read_text().count("quaternion_wxyz") == 3


def test_compare_prints_a_row_per_method(calib, recorded):
    result = calib("compare", recorded[0])
    assert result.returncode == 0, result.stderr
    assert all(f"| {name} |" in result.stdout for name in ("park", "shah", "refinement, all views"))


def test_importing_calib_does_not_touch_jax():
    """Float64 is a switch of the whole process: nobody who trains may find it thrown by a calibration."""
    code = (
        "import importlib, pkgutil, sys\nfrom koala3d import calib\n"
        "modules = [importlib.import_module(found.name) for found in pkgutil.walk_packages(calib.__path__, 'koala3d.calib.')]\n"
        "print(len(modules), 'jax' in sys.modules)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr
    number, touched = result.stdout.split()
    assert int(number) > 25 and touched == "False"
