"""Scenes, recordings and pictures of strangers: nothing is written or copied from outside,
nothing takes the computer's memory."""

import json
import os
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.building.build import build
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.core.errors import DatasetError, KoalaError, UsageError
from koala3d.datasets.core.schema import Schema, load_yaml
from koala3d.datasets.edit import edit
from koala3d.datasets.formats import load_scene, save_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import Frame, Recording
from koala3d.datasets.scene import Scene

LAYOUTS = ("koala", "blender", "nerfstudio", "llff", "dtu", "colmap")


def with_truth_key(folder: Path, key: str) -> None:
    """Rename the truth channel "depth" of every view in a scene's own file."""
    for name in ("cameras.json", "koala.json"):
        path = folder / name
        if path.is_file():
            content = json.loads(path.read_text())
            views = content["views"]
            for view in views if isinstance(views, list) else views.values():
                if "depth" in view["truth"]:
                    view["truth"] = {key: view["truth"]["depth"]}
                    view["name"] = "authorized_keys"
            path.write_text(json.dumps(content))


@pytest.fixture
def scene_with_truth(make_scene: Callable[..., Scene]) -> Scene:
    return make_scene(count=4)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_truth_channel_is_one_of_the_known_names(scene_with_truth: Scene, tmp_path: Path, layout: str) -> None:
    save_scene(scene_with_truth, tmp_path / "scene", layout)
    with_truth_key(tmp_path / "scene", "../../../victim/.ssh")
    with pytest.raises(DatasetError, match="channel"):
        load_scene(tmp_path / "scene")


@pytest.mark.parametrize("layout", ["koala", "nerfstudio"])
def test_nothing_is_written_outside_the_output_folder(scene_with_truth: Scene, tmp_path: Path, layout: str) -> None:
    save_scene(scene_with_truth, tmp_path / "scene", "koala")
    with_truth_key(tmp_path / "scene", "../../../victim/.ssh")
    (tmp_path / "deep").mkdir()
    try:
        scene = load_scene(tmp_path / "scene")
        save_scene(scene, tmp_path / "deep" / "out", layout)
        edit.downscaled(scene, 2, tmp_path / "deep" / "work")
    except KoalaError:
        pass  # to refuse it is right, too
    assert not (tmp_path / "victim").exists()


def test_a_link_among_the_true_meshes_is_not_copied(scene_with_truth: Scene, tmp_path: Path) -> None:
    from koala3d.datasets.building.build import extra_truth

    save_scene(scene_with_truth, tmp_path / "scene", "koala")
    (tmp_path / "secret").write_text("private key")
    (tmp_path / "scene" / "truth" / "object.ply").symlink_to(tmp_path / "secret")
    try:
        save_scene(load_scene(tmp_path / "scene"), tmp_path / "out", "koala", extra=extra_truth(tmp_path / "scene"))
    except KoalaError:
        return
    assert not (tmp_path / "out" / "truth" / "object.ply").exists()


def stranger_recording(folder: Path, name: str) -> tuple[Path, Path]:
    """A recording of one frame with a name of a stranger's choice, and a calibration that fits."""
    from koala3d.datasets import pose
    from koala3d.datasets.camera_model import Camera

    camera = Camera(16, 12, 20.0, 20.0, 8.0, 6.0)
    volume = {"centre": [0.0, 0.0, 0.0], "size": [0.1, 0.1, 0.1]}
    recording = Recording.create(folder / "recording", {"trajectory": {}, "object": volume})
    images.write(recording.path / "images" / "0.png", np.zeros((12, 16, 3), np.uint8))
    recording.append(
        Frame(
            index=0,
            name=name,
            split="train",
            image="images/0.png",
            base_from_flange=pose.look_at((0.5, 0, 0.5), (0, 0, 0)),
            joints=np.zeros(6),
            robot_time_s=0.0,
            host_time_ns=0,
            device_ticks=0,
            exposure_us=1e4,
            settle_s=0.1,
            sha256="",
        )
    )
    known = UncertainPose(np.eye(4), 1e-8 * np.eye(6))
    Calibration(camera, {}, known, known).save(folder / "calibration.json")
    return recording.path, folder / "calibration.json"


def test_a_frames_name_does_not_lead_out_of_the_truth_folder(tmp_path: Path) -> None:
    recording, calibration = stranger_recording(tmp_path, "../../../secret")
    (recording / "truth" / "depth").mkdir(parents=True)
    (tmp_path / "secret.exr").write_bytes(b"private")
    try:
        scene = build(recording, calibration, tmp_path / "out")
    except KoalaError:
        return
    assert not any(path.resolve() == (tmp_path / "secret.exr").resolve() for view in scene.views for path in view.truth.values())


def test_a_recordings_truth_channel_that_is_a_link_is_not_copied(tmp_path: Path) -> None:
    recording, calibration = stranger_recording(tmp_path, "0")
    (recording / "truth").mkdir()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "0.exr").write_bytes(b"private")
    (recording / "truth" / "depth").symlink_to(tmp_path / "elsewhere")
    try:
        build(recording, calibration, tmp_path / "out")
    except KoalaError:
        return
    assert not list((tmp_path / "out").glob("truth/*/*"))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_an_images_folder_that_is_a_link_is_followed(make_scene: Callable[..., Scene], tmp_path: Path, layout: str) -> None:
    save_scene(make_scene(count=4, truth=False), tmp_path / "scene", layout)
    moved = False
    for name in ("images", "image", "train", "test"):
        home = tmp_path / "scene" / name
        if home.is_dir():
            home.rename(tmp_path / f"big_{name}")
            home.symlink_to(tmp_path / f"big_{name}")
            moved = True
    assert moved
    for view in load_scene(tmp_path / "scene", format=layout).views:
        assert view.read().ndim == 3


@pytest.mark.parametrize("name", ["../secret.png", "/etc/passwd"])
def test_a_path_in_a_file_that_leaves_the_folder_is_refused(make_scene: Callable[..., Scene], tmp_path: Path, name: str) -> None:
    save_scene(make_scene(count=3, truth=False), tmp_path / "scene", "koala")
    content = json.loads((tmp_path / "scene" / "cameras.json").read_text())
    content["views"][0]["image"] = name
    (tmp_path / "scene" / "cameras.json").write_text(json.dumps(content))
    with pytest.raises(DatasetError, match="leaves the folder"):
        load_scene(tmp_path / "scene")


def png_of_zeros(side: int) -> bytes:
    """A sound PNG of black RGB pixels, a thousandth of its size in memory."""
    packer = zlib.compressobj(9)
    packed = b"".join(packer.compress(b"\0" * (1 + 3 * side)) for _ in range(side)) + packer.flush()
    chunks = ((b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)), (b"IDAT", packed), (b"IEND", b""))
    body = b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + body


def test_a_picture_that_unpacks_to_gigabytes_is_refused_with_its_budget(tmp_path: Path) -> None:
    path = tmp_path / "bomb.png"
    path.write_bytes(png_of_zeros(16384))
    assert path.stat().st_size < 2**20
    with pytest.raises(DatasetError, match=r"budget.*pixels") as refused:
        images.size(path)  # the header alone: the test would not survive the decoding
    assert "KOALA_" in str(refused.value) or "--" in str(refused.value), "it says how to raise the budget"


class Free(Schema):
    """A file that may hold anything."""

    values: object = None


@pytest.mark.timeout(60)
def test_yaml_whose_aliases_multiply_is_refused_at_once(tmp_path: Path) -> None:
    lines = ["a0: &a0 [0, 0, 0, 0, 0, 0, 0, 0, 0]"]
    lines += [f"a{n}: &a{n} [" + ", ".join([f"*a{n - 1}"] * 9) + "]" for n in range(1, 9)]
    path = tmp_path / "bomb.yaml"
    path.write_text("\n".join([*lines, "values: *a8"]))
    code = (
        "import sys; from pathlib import Path; from koala3d.datasets.core.schema import read_yaml\n"
        "import resource; resource.setrlimit(resource.RLIMIT_CPU, (4, 4))\n"
        "try: read_yaml(Path(sys.argv[1]))\n"
        "except Exception as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=False, timeout=50)
    assert done.returncode == 0 and "budget" in done.stdout, f"ended with {done.returncode}: {done.stdout}"


def test_a_huge_yaml_file_is_refused_before_it_is_parsed(tmp_path: Path) -> None:
    path = tmp_path / "huge.yaml"
    with open(path, "wb") as file:
        file.truncate(2**27)  # a hole: it costs no disk
    with pytest.raises(UsageError, match="large"):
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr("yaml.compose", lambda *a, **k: pytest.fail("it was parsed"))
            load_yaml(path, Free)


@pytest.mark.parametrize("way", ["fifo", "device", "loop"])
@pytest.mark.timeout(60)
def test_what_is_no_file_is_refused_and_not_waited_for(tmp_path: Path, way: str) -> None:
    path = tmp_path / "trajectory.yaml"
    if way == "fifo":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero" if way == "device" else path.name)
    code = (
        "import resource, sys; from pathlib import Path; from koala3d.datasets.core.schema import read_yaml\n"
        "from koala3d.datasets.core.errors import KoalaError\n"
        "resource.setrlimit(resource.RLIMIT_AS, (2**30, 2**30))\n"
        "try: read_yaml(Path(sys.argv[1]))\n"
        "except KoalaError as error: print('refused:', error)\n"
    )
    try:
        done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=False, timeout=8)
    except subprocess.TimeoutExpired:
        pytest.fail("it was waited for")
    assert done.stdout.startswith("refused:"), done.stderr[-200:]


@pytest.mark.parametrize("name", ["", "..", "a\nb", "a\0b", "\ud800", "x" * 300])
@pytest.mark.parametrize("layout", ["koala", "nerfstudio"])
def test_a_view_whose_name_cannot_name_a_file_is_refused(
    make_scene: Callable[..., Scene], tmp_path: Path, name: str, layout: str
) -> None:
    save_scene(make_scene(count=3, truth=False), tmp_path / "scene", layout)
    path = tmp_path / "scene" / ("cameras.json" if layout == "koala" else "koala.json")
    content = json.loads(path.read_text())
    views = content["views"]
    (views[0] if isinstance(views, list) else next(iter(views.values())))["name"] = name
    path.write_text(json.dumps(content))
    with pytest.raises(DatasetError, match="cannot name a file"):
        load_scene(tmp_path / "scene")


@pytest.mark.parametrize("layout", ["koala", "nerfstudio", "blender"])
def test_a_view_that_is_listed_thousands_of_times_is_refused_before_its_images_are_opened(
    make_scene: Callable[..., Scene], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, layout: str
) -> None:
    save_scene(make_scene(count=3, truth=False), tmp_path / "scene", layout)
    name = {"koala": "cameras.json", "nerfstudio": "transforms.json", "blender": "transforms_train.json"}[layout]
    content = json.loads((tmp_path / "scene" / name).read_text())
    content["views" if layout == "koala" else "frames"] *= 3000
    (tmp_path / "scene" / name).write_text(json.dumps(content))
    monkeypatch.setattr(images, "size", lambda path: pytest.fail("an image was opened"))
    with pytest.raises(DatasetError, match="listed twice"):
        load_scene(tmp_path / "scene")


@pytest.mark.parametrize(
    "key, value", [("provenance", {"a": float("nan")}), ("depth_unit", float("nan")), ("near", float("inf"))]
)
def test_numbers_that_cannot_be_written_again_are_not_read(
    make_scene: Callable[..., Scene], tmp_path: Path, key: str, value: object
) -> None:
    save_scene(make_scene(count=3, truth=False), tmp_path / "scene", "koala")
    content = json.loads((tmp_path / "scene" / "cameras.json").read_text())
    (content["views"][0] if key == "depth_unit" else content)[key] = value
    (tmp_path / "scene" / "cameras.json").write_text(json.dumps(content))
    with pytest.raises(DatasetError):
        load_scene(tmp_path / "scene")


@pytest.mark.parametrize(
    "key, value", [("index", "1"), ("name", "a\nb"), ("exposure_us", float("nan")), ("sha256", 5), ("image", None)]
)
def test_a_frame_with_a_value_of_another_kind_is_refused(tmp_path: Path, key: str, value: object) -> None:
    recording, _ = stranger_recording(tmp_path, "0")
    line = json.loads((recording / "frames.jsonl").read_text())
    (recording / "frames.jsonl").write_text(json.dumps({**line, key: value}) + "\n")
    with pytest.raises(DatasetError, match=r"frames\.jsonl, line 1"):
        Recording.open(recording)
