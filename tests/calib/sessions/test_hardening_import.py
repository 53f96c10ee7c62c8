"""Sessions of strangers: the description is named by who imports, and reads nothing outside its folder."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from koala3d.calib.sessions import importer
from koala3d.datasets.core.errors import KoalaError, UsageError
from koala3d.datasets.imaging import images

BOARD = {
    "type": "charuco",
    "squares_x": 5,
    "squares_y": 4,
    "square_length_m": 0.03,
    "marker_length_m": 0.02,
    "dictionary": "DICT_4X4_50",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A session of one picture with its pose."""
    path = tmp_path / "session"
    images.write(path / "0.png", np.zeros((60, 80), np.uint8))
    (path / "pose-0.yaml").write_text("data: [0, 0, 0.5, 0, 0, 0]\n")
    describe(path)
    return path


def describe(folder: Path, **changes: object) -> None:
    content = {"images": "*.png", "poses": "pose-*.yaml", "key": "data", "layout": "x y z rx ry rz", "board": BOARD, **changes}
    (folder / "import.yaml").write_text(yaml.safe_dump(content))


def test_a_description_in_a_strangers_folder_is_not_picked_up_by_itself(folder: Path) -> None:
    with pytest.raises(UsageError, match=r"is not a recording .* give --import .*import\.yaml"):
        importer.observe_folder(folder)


@pytest.mark.parametrize(
    "changes",
    [
        {"images": "../secret/*.png"},
        {"poses": "../secret/pose-*.yaml"},
        {"poses": "../secret/pose-0.yaml"},
        {"images": "{absolute}/*.png"},
        {"poses": "{absolute}/pose-0.yaml"},
    ],
    ids=["images", "poses", "one file", "absolute images", "absolute poses"],
)
def test_a_pattern_that_leaves_the_folder_is_refused(folder: Path, tmp_path: Path, changes: dict[str, str]) -> None:
    secret = tmp_path / "secret"
    images.write(secret / "0.png", np.zeros((60, 80), np.uint8))
    (secret / "pose-0.yaml").write_text("data: [0, 0, 0.5, 0, 0, 0]\n")
    describe(folder, **{key: value.format(absolute=secret) for key, value in changes.items()})
    with pytest.raises(KoalaError, match="leaves the folder"):
        importer.import_session(folder, importer.load_description(folder / "import.yaml"))


@pytest.mark.parametrize(
    "text",
    [
        pytest.param("data: 2001-99-99\n", id="date"),
        pytest.param("[" * 3000, id="deep"),
        pytest.param("data: [1, \x00]\n", id="zero byte"),
        pytest.param("data: 190:20:30\n", id="sexagesimal"),
        pytest.param("data: " + "9" * 5000, id="digits"),
    ],
)
def test_a_pose_file_that_is_no_yaml_is_one_line(folder: Path, text: str) -> None:
    (folder / "pose-0.yaml").write_text(text)
    with pytest.raises(KoalaError) as refused:
        importer.import_session(folder, importer.load_description(folder / "import.yaml"))
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.timeout(60)
def test_a_pose_file_whose_aliases_multiply_is_refused(folder: Path) -> None:
    lines = ["a0: &a0 [0, 0, 0, 0, 0, 0, 0, 0, 0]"]
    lines += [f"a{n}: &a{n} [" + ", ".join([f"*a{n - 1}"] * 9) + "]" for n in range(1, 9)]
    (folder / "pose-0.yaml").write_text("\n".join([*lines, "data: *a8"]))
    code = (
        "import resource, sys; from pathlib import Path\n"
        "from koala3d.calib.sessions import importer; from koala3d.datasets.core.errors import KoalaError\n"
        "folder = Path(sys.argv[1])\n"
        "import cv2, scipy.spatial; description = importer.load_description(folder / 'import.yaml')\n"
        "resource.setrlimit(resource.RLIMIT_CPU, (10, 10)); resource.setrlimit(resource.RLIMIT_AS, (4 * 2**30,) * 2)\n"
        "try: importer.import_session(folder, description)\n"
        "except KoalaError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(folder)], capture_output=True, text=True, check=False, timeout=50)
    assert "budget" in done.stdout, f"ended with {done.returncode}: {done.stdout}{done.stderr[-300:]}"
