"""Made-up folders of other programs: what their formats allow, and what goes wrong in them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.conventions import OPENCV_FROM_LLFF, OPENCV_FROM_OPENGL
from koala3d.datasets.core.errors import DatasetError, KoalaError, UsageError
from koala3d.datasets.formats import llff, load_scene
from tests.foreign import photographs

SIZE = (30, 40, 3)


def noise(seed: int) -> NDArray[np.uint8]:
    """A picture."""
    return np.random.default_rng(seed).integers(0, 256, SIZE, np.uint8)


@pytest.fixture
def transforms(tmp_path: Path) -> Callable[..., Path]:
    """Writes a nerfstudio folder of ten images; keyword arguments enter the file, `frame` each frame."""

    def write(*, frame: dict[str, Any] | None = None, drop: tuple[str, ...] = (), **content: Any) -> Path:
        frames = []
        for index in range(10):
            image = f"images/{index:02d}.png"
            photographs.write(tmp_path / image, noise(index), Make="Koala", FocalLengthIn35mmFilm=26)
            matrix = pose.look_at((np.cos(index), np.sin(index), 0.5), (0, 0, 0)) @ OPENCV_FROM_OPENGL
            frames.append({"file_path": image, "transform_matrix": matrix.tolist(), **(frame or {})})
        known = {"fl_x": 50.0, "fl_y": 51.0, "cx": 20.5, "cy": 14.5, "w": 40, "h": 30, "frames": frames, **content}
        (tmp_path / "transforms.json").write_text(json.dumps({k: v for k, v in known.items() if k not in drop}))
        return tmp_path

    return write


def test_opengl_axes_become_ours(transforms: Callable[..., Path]) -> None:
    scene = load_scene(transforms())
    for index, view in enumerate(scene.views):
        assert np.abs(view.world_from_camera - pose.look_at((np.cos(index), np.sin(index), 0.5), (0, 0, 0))).max() < 1e-12
    assert scene.views[0].camera == Camera(40, 30, 50.0, 51.0, 20.5, 14.5)
    assert [view.split for view in scene.views] == ["test", *["train"] * 7, "test", "train"]


def test_nerfstudios_order_of_distortion_params(transforms: Callable[..., Path]) -> None:
    camera = load_scene(transforms(distortion_params=[0.1, 0.2, 0.3, 0.0, 0.4, 0.5])).views[0].camera
    assert (camera.k1, camera.k2, camera.k3, camera.p1, camera.p2) == (0.1, 0.2, 0.3, 0.4, 0.5)


def test_field_of_view_replaces_the_focal_length(transforms: Callable[..., Path]) -> None:
    folder = transforms(
        drop=("fl_x", "fl_y", "cx", "cy", "w", "h"), camera_angle_x=2 * np.arctan(20 / 70), camera_angle_y=2 * np.arctan(15 / 80)
    )
    camera = load_scene(folder).views[0].camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx((70, 80, 20, 15))


def test_a_frames_own_intrinsics_take_precedence(transforms: Callable[..., Path]) -> None:
    assert load_scene(transforms(frame={"fl_x": 60.0})).views[3].camera.fx == 60.0


def test_splits_of_the_file_are_kept(transforms: Callable[..., Path]) -> None:
    names = [f"images/{index:02d}.png" for index in range(10)]
    scene = load_scene(transforms(train_filenames=names[:6], val_filenames=names[6:8], test_filenames=names[8:]))
    assert [view.split for view in scene.views] == ["train"] * 6 + ["val"] * 2 + ["test"] * 2
    with pytest.raises(DatasetError, match=r"test_filenames lists names that are not among the frames \(other\.png\)"):
        load_scene(transforms(test_filenames=["other.png"]))


def test_masks_of_all_frames_make_a_white_background(transforms: Callable[..., Path], tmp_path: Path) -> None:
    photographs.write(tmp_path / "mask.png", np.uint8(255 * (np.arange(40) > 3) * np.ones((30, 1))))
    scene = load_scene(transforms(frame={"mask_path": "mask.png"}))
    assert scene.background == "white" and scene.views[0].read().shape == (30, 40, 4)


def test_an_opaque_alpha_is_no_mask(transforms: Callable[..., Path]) -> None:
    """Many programs write RGBA whatever the picture: the surroundings are seen, and nothing is carved."""
    folder = transforms()
    for index in range(10):
        opaque = np.full((30, 40, 1), 255, np.uint8)
        photographs.write(folder / f"images/{index:02d}.png", np.concatenate([noise(index), opaque], -1))
    scene = load_scene(folder)
    assert scene.background == "scene" and scene.views[0].read().shape == (30, 40, 4)


@pytest.mark.parametrize(
    ("stated", "there", "moved"),
    [
        ("./images/{:02d}.png", "images/{:02d}.png", False),
        ("images\\{:02d}.png", "images/{:02d}.png", False),
        (".\\rgb\\{:02d}.png", "rgb/{:02d}.png", False),
        ("images/{:02d}", "images/{:02d}.PNG", False),
        ("images/{:02d}.jpg", "images/{:02d}.png", False),
        ("{:02d}.png", "{:02d}.png", False),
        ("images/{:02d}.png", "images_2/{:02d}.png", True),
        ("train/{:02d}.png", "rgb/{:02d}.png", True),
    ],
)
def test_images_are_found_where_they_are(transforms: Callable[..., Path], stated: str, there: str, moved: bool) -> None:
    folder = transforms()
    before = [view.read() for view in load_scene(folder).views]
    content = json.loads((folder / "transforms.json").read_text())
    for index, frame in enumerate(content["frames"]):
        frame["file_path"] = stated.format(index)
        (folder / there.format(index)).parent.mkdir(exist_ok=True)
        (folder / f"images/{index:02d}.png").rename(folder / there.format(index))
    if not any((folder / "images").iterdir()):
        (folder / "images").rmdir()
    (folder / "transforms.json").write_text(json.dumps(content))
    scene = load_scene(folder)
    assert [np.array_equal(view.read(), old) for view, old in zip(scene.views, before, strict=True)] == [True] * 10
    assert any("images are taken from" in note for note in scene.notes) == moved


def test_each_frame_may_have_its_own_lens(transforms: Callable[..., Path]) -> None:
    folder = transforms(drop=("fl_x", "fl_y", "cx", "cy", "w", "h"))
    content = json.loads((folder / "transforms.json").read_text())
    for index, frame in enumerate(content["frames"]):
        frame |= {"fl_x": 50.0 + index, "fl_y": 51.0, "cx": 20.0, "cy": 15.0, "w": 40, "h": 30, "k1": 0.01 * index, "k4": 0}
        frame["camera_model"] = "OPENCV_FISHEYE" if index == 3 else "SIMPLE_RADIAL"
    (folder / "transforms.json").write_text(json.dumps(content))
    cameras = [view.camera for view in load_scene(folder).views]
    assert [camera.fx for camera in cameras] == [50.0 + index for index in range(10)]
    assert [camera.k1 for camera in cameras] == [0.01 * index for index in range(10)]
    assert [camera.fisheye for camera in cameras] == [index == 3 for index in range(10)]


def test_masks_of_a_blender_file_are_read(transforms: Callable[..., Path], tmp_path: Path) -> None:
    photographs.write(tmp_path / "mask.png", np.uint8(255 * (np.arange(40) > 30) * np.ones((30, 1))))
    folder = transforms(frame={"mask_path": ".\\mask.png"})
    (folder / "transforms.json").rename(folder / "transforms_train.json")
    scene = load_scene(folder)
    assert scene.background == "white" and scene.provenance["format"] == "blender" and scene.views[0].read().shape[-1] == 4


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"camera_model": "EQUIRECTANGULAR"}, "camera model EQUIRECTANGULAR is not supported"),
        ({"camera_model": 7}, "camera model 7 is not supported"),
        ({"k4": 0.1}, "k4 = 0.1 as the fourth radial coefficient is not supported.*datasets edit .* --undistort"),
        ({"drop": ("fl_x", "fl_y")}, "no focal length"),
        ({"fl_x": float("nan")}, "not finite"),
        ({"fl_x": "wide"}, "camera is not complete"),
        ({"frames": []}, r"scene has no images \(transforms.json lists none\)"),
        ({"frames": [{"file_path": "images/none.png"}]}, "lists 1, none of which exists"),
        ({"frames": [{"path": "x"}]}, "no list of frames"),
        ({"frames": [{"file_path": "../../etc/passwd"}]}, "lists 1, none of which exists"),
        ({"frame": {"transform_matrix": [[1, 0], [0, 1]]}}, "pose is not 4x4"),
        ({"frame": {"transform_matrix": np.full((4, 4), np.nan).tolist()}}, "pose is not finite"),
    ],
)
def test_what_cannot_be_read_is_named(transforms: Callable[..., Path], content: dict[str, Any], words: str) -> None:
    with pytest.raises(DatasetError, match=words) as caught:
        load_scene(transforms(**content))
    assert "\n" not in str(caught.value)


def test_problems_are_collected_in_a_list(transforms: Callable[..., Path]) -> None:
    folder = transforms()
    content = json.loads((folder / "transforms.json").read_text())
    content["frames"][2]["transform_matrix"][0][0] = float("nan")
    (folder / "transforms.json").write_text(json.dumps(content))
    problems: list[KoalaError] = []
    scene = load_scene(folder, problems=problems)
    assert len(scene.views) == 9 and len(problems) == 1 and "images/02.png" in str(problems[0])


@pytest.fixture
def rows(tmp_path: Path) -> Callable[..., Path]:
    """Writes an LLFF folder of eight images; `change` alters the (8, 17) rows first."""

    def write(change: Callable[[np.ndarray], None] = lambda rows: None) -> Path:
        made = []
        for index in range(8):
            photographs.write(tmp_path / "images" / f"{index}.png", noise(index))
            matrix = pose.look_at((0.1 * index, 0, -1), (0, 0, 2)) @ OPENCV_FROM_LLFF
            made.append(np.concatenate([np.c_[matrix[:3], [60, 80, 100]].ravel(), [1.0, 5.0]]))
        made = np.stack(made)
        change(made)
        np.save(tmp_path / "poses_bounds.npy", made)
        return tmp_path

    return write


def test_llff_columns_by_hand(tmp_path: Path) -> None:
    """Axes down, right, back of a camera with our axes in the world: (0 1 0), (1 0 0), (0 0 -1)."""
    row = np.concatenate([np.c_[[[0, 1, 0], [1, 0, 0], [0, 0, -1]], [7, 8, 9], [60, 80, 100]].ravel(), [1.0, 5.0]])
    photographs.write(tmp_path / "images" / "a.png", np.zeros(SIZE, np.uint8))
    np.save(tmp_path / "poses_bounds.npy", row[None])
    view = load_scene(tmp_path, hold_out=0).views[0]
    assert np.array_equal(view.world_from_camera, pose.rigid(np.eye(3), (7, 8, 9)))
    assert view.camera == Camera(40, 30, 50.0, 50.0, 20.0, 15.0)  # half the size that hwf speaks of
    assert np.array_equal(llff.row_of(view.world_from_camera, Camera(80, 60, 100, 100, 40, 30), 1, 5), row)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rows: rows.__setitem__((3, 3), np.nan), r"row 3 \(3\.png\): pose is not finite"),
        (lambda rows: rows.__setitem__((3, 4), 0), "height, width and focal length are not positive"),
        (lambda rows: rows.__setitem__((slice(None), 9), 60), "image has another shape than its camera"),
        (lambda rows: rows.__setitem__((slice(None), 15), 9), "near and far are not in order"),
        (lambda rows: rows.__setitem__((0, 16), np.nan), "near and far are not in order"),
    ],
)
def test_impossible_rows_are_named(rows: Callable[..., Path], change: Callable, words: str) -> None:
    with pytest.raises(DatasetError, match=words):
        load_scene(rows(change))


def test_rows_and_images_must_correspond(rows: Callable[..., Path]) -> None:
    folder = rows()
    (folder / "images" / "3.png").unlink()
    with pytest.raises(DatasetError, match="8 rows, images holds 7 images"):
        load_scene(folder)


def test_pickles_are_never_opened(rows: Callable[..., Path]) -> None:
    folder = rows()
    np.save(folder / "poses_bounds.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(DatasetError, match="Python objects"):
        load_scene(folder)


def test_the_largest_images_are_used_by_default(rows: Callable[..., Path]) -> None:
    folder = rows()
    for index in range(8):
        photographs.write(folder / "images_2" / f"{index}.png", np.zeros((15, 20, 3), np.uint8))
    assert load_scene(folder).views[0].camera.width == 40
    assert load_scene(folder, images="images_2").views[0].camera == Camera(20, 15, 25.0, 25.0, 10.0, 7.5)
    with pytest.raises(UsageError, match="no folder of images"):
        load_scene(folder, images="images_4")


def test_blender_without_test_file_holds_out(tmp_path: Path) -> None:
    frames = []
    for index in range(9):
        photographs.write(tmp_path / "train" / f"{index}.png", np.uint8(np.arange(40)[:, None] / 39 * np.full((30, 1, 4), 255)))
        matrix = pose.look_at((np.cos(index), np.sin(index), 0.5), (0, 0, 0)) @ OPENCV_FROM_OPENGL
        frames.append({"file_path": f"./train/{index}", "transform_matrix": matrix.tolist()})
    (tmp_path / "transforms_train.json").write_text(json.dumps({"camera_angle_x": 0.7, "frames": frames}))
    scene = load_scene(tmp_path)
    assert len(scene.split("test")) == 2 and scene.background == "white"
    view = scene.views[0]
    assert np.array_equal(np.rint(255 * view.read()), photographs.shown(view.image)), "colours and a straight alpha"
