"""Folders as other programs leave them: what is read, what is left out with a note, and what is refused with a remedy."""

import json
import unicodedata
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from koala3d.datasets import pose
from koala3d.datasets.checks.check import check
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.formats import load_scene, save_scene
from koala3d.datasets.formats.colmap_files import read_model
from tests.foreign import colmap, photographs

LENS = {"PINHOLE": (90.0, 90.0, 60.0, 40.0)}
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
Writer = Callable[..., Path]


def poses(count: int = 8) -> list[np.ndarray]:
    return colmap.ring(count)


@pytest.fixture
def transforms(tmp_path: Path) -> Writer:
    """Writes eight frames of 120x80 with `path` as their file_path; `change` alters matrices, `frame` gives further keys."""

    def write(
        *,
        path: str = "images/{:02d}.png",
        change: Any = lambda m: m,
        frame: Any = lambda k: {},
        encoding: str = "utf-8",
        **content: Any,
    ) -> Path:
        frames = []
        for k, matrix in enumerate(poses()):
            photographs.write(tmp_path / f"images/{k:02d}.png", np.roll(photographs.corners(), 5 * k, axis=1))
            entry = {"file_path": path.format(k), "transform_matrix": change(matrix @ OPENGL).tolist(), **frame(k)}
            frames.append(entry)
        known = {"fl_x": 90.0, "cx": 60.0, "cy": 40.0, "w": 120, "h": 80, **content, "frames": frames}
        (tmp_path / "transforms.json").write_text(json.dumps(known), encoding=encoding)
        return tmp_path

    return write


def right(folder: Path) -> bool:
    """Whether every view has its own picture, as Pillow reads it, and its own pose."""
    for k, (view, matrix) in enumerate(zip(load_scene(folder).views, poses(), strict=True)):
        with Image.open(folder / f"images/{k:02d}.png") as picture:
            same = np.array_equal(np.rint(255 * view.read()), np.asarray(picture))
        if not (same and np.abs(view.world_from_camera - matrix).max() < 1e-9):
            return False
    return True


@pytest.mark.parametrize(
    "path",
    [
        "/home/someone/data/statue/images/{:02d}.png",
        "C:\\Users\\someone\\statue\\images\\{:02d}.png",
        "../statue/images/{:02d}.png",
        "/mnt/other/{:02d}.jpg",
    ],
)
def test_paths_of_another_machine_stand_for_the_pictures_of_their_names(transforms: Writer, path: str) -> None:
    folder = transforms(path=path)
    assert right(folder)
    assert any("8 paths leave the folder" in note for note in load_scene(folder).notes)


def test_nothing_outside_the_folder_is_opened(transforms: Writer, tmp_path: Path) -> None:
    photographs.write(tmp_path.parent / "outside" / "secret.png", photographs.corners())
    folder = transforms(path="../outside/secret.png", frame=lambda k: {"file_path": f"../outside/{k}/secret.png"})
    with pytest.raises(DatasetError, match=r"no images|none of which exists"):
        load_scene(folder)
    with pytest.raises(DatasetError, match="leaves the folder"):
        load_scene(transforms(frame=lambda k: {"mask_path": "../outside/secret.png"}))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_byte_order_mark_changes_nothing(transforms: Writer, encoding: str) -> None:
    assert right(transforms(encoding=encoding))


@pytest.mark.parametrize(
    ("key", "file_from_opencv"),
    [("from_na", np.eye(4)), ("from_mitsuba", np.diag([-1.0, -1.0, 1.0, 1.0]))],
)
def test_axes_that_a_file_states_are_used(transforms: Writer, key: str, file_from_opencv: np.ndarray) -> None:
    """instant-ngp's keys: OpenCV's axes, and Mitsuba's with x left, y up, z forward."""
    assert right(transforms(change=lambda m: m @ OPENGL @ file_from_opencv, **{key: True}))


@pytest.mark.parametrize("scale", [2.0, 1.056, 0.01])
def test_the_scale_of_a_matrix_is_divided_out(transforms: Writer, scale: float) -> None:
    """As cameras of Blender have it that were scaled, and models that were aligned."""
    folder = transforms(change=lambda m: np.hstack([m[:, :3] * scale, m[:, 3:]]))
    assert right(folder) and any("rotations have a scale" in note for note in load_scene(folder).notes)


def test_a_sheared_matrix_is_refused_with_the_lengths_of_its_columns(transforms: Writer) -> None:
    shear = np.eye(4)
    shear[0, 1] = 0.2
    with pytest.raises(DatasetError, match=r"not a rotation.*lengths 1, 1\.02, 1\); write rotations without"):
        load_scene(transforms(change=lambda m: m @ shear))


def test_frames_in_no_list_and_bad_frames_are_left_out(transforms: Writer) -> None:
    """nerfstudio leaves out what no list names; ScanNet++ marks blurred frames."""
    names = [f"images/{k:02d}.png" for k in range(8)]
    lists = {"train_filenames": names[:5], "val_filenames": names[5:6], "test_filenames": names[5:6]}
    scene = load_scene(transforms(frame=lambda k: {"is_bad": k == 1}, **lists))
    assert [view.name for view in scene.views] == [f"images/{k:02d}" for k in (0, 2, 3, 4, 5)]
    assert "2 of 8 frames are in no list of file names and are left out" in scene.notes
    assert "1 frames that the file calls bad are left out" in scene.notes


def test_test_frames_of_their_own_are_test_views(transforms: Writer) -> None:
    folder = transforms()
    content = json.loads((folder / "transforms.json").read_text())
    content["test_frames"] = content["frames"][6:]
    content["frames"] = content["frames"][:6]
    (folder / "transforms.json").write_text(json.dumps(content))
    assert right(folder) and [view.split for view in load_scene(folder).views] == ["train"] * 6 + ["test"] * 2


@pytest.mark.parametrize("size", [(64, 48), (120, 80)])
def test_depth_of_a_sensor_is_no_truth(transforms: Writer, tmp_path: Path, size: tuple[int, int]) -> None:
    (tmp_path / "depth").mkdir()
    for k in range(8):
        Image.fromarray(np.full(size[::-1], 1500, np.uint16)).save(tmp_path / f"depth/{k:02d}.png")
    scene = load_scene(transforms(frame=lambda k: {"depth_file_path": f"depth/{k:02d}.png"}))
    assert all(not view.truth for view in scene.views) and any("not read as truth" in note for note in scene.notes)


@pytest.mark.parametrize(
    ("frame", "note"),
    [
        (lambda k: {"time": k / 7}, "frames are of 8 times; what moves in between is not known"),
        (lambda k: {"rolling_shutter_time": 0.02}, "the motion of a rolling shutter is not read"),
    ],
)
def test_what_a_scene_cannot_hold_is_said(transforms: Writer, frame: Any, note: str) -> None:
    assert any(note in one for one in load_scene(transforms(frame=frame)).notes)


@pytest.mark.parametrize(
    "keys", [{"latlong": True}, {"equirectangular": True}, {"camera_model": "EQUIRECTANGULAR"}, {"ftheta_p1": 0.01}]
)
def test_lenses_that_are_stated_by_keys_are_refused(transforms: Writer, keys: dict[str, Any]) -> None:
    with pytest.raises(DatasetError, match=r"camera model (EQUIRECTANGULAR|F-THETA) is not supported.*; (cut|undistort)"):
        load_scene(transforms(**keys))


def test_masks_of_what_moves_are_named(transforms: Writer) -> None:
    folder = transforms()
    photographs.write(folder / "images/dynamic_mask_03.png", np.full((80, 120), 255, np.uint8))
    assert any("dynamic_mask_*.png, which hide what moves, are not used" in note for note in load_scene(folder).notes)


def test_dots_in_a_name_without_suffix_belong_to_it(transforms: Writer, tmp_path: Path) -> None:
    folder = transforms()
    content = json.loads((folder / "transforms.json").read_text())
    for k, frame in enumerate(content["frames"]):
        (folder / f"images/{k:02d}.png").rename(folder / f"images/1403636579.{k:04d}.png")
        frame["file_path"] = f"images/1403636579.{k:04d}"
    (folder / "transforms.json").write_text(json.dumps(content))
    assert [view.name for view in load_scene(folder).views] == [f"images/1403636579.{k:04d}" for k in range(8)]


def test_points_that_are_not_finite_are_left_out(transforms: Writer, tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(0, 0.1, (30, 3))
    points[3, 1] = np.nan
    trimesh.PointCloud(points).export(tmp_path / "cloud.ply")
    scene = load_scene(transforms(ply_file_path="cloud.ply"))
    np.testing.assert_allclose(scene.points, np.delete(points, 3, 0), atol=1e-6)  # floats
    assert "1 points of cloud.ply are not finite and are left out" in scene.notes


@pytest.mark.parametrize("without", [1, 5])
def test_views_without_a_mask_are_left_out_or_the_masks_are(transforms: Writer, tmp_path: Path, without: int) -> None:
    mask = np.zeros((80, 120), np.uint8)
    mask[20:60, 30:90] = 255
    photographs.write(tmp_path / "mask.png", mask)
    scene = load_scene(transforms(frame=lambda k: {} if k < without else {"mask_path": "mask.png"}))
    assert (len(scene.views), scene.background) == ((7, "white") if without == 1 else (8, "scene"))
    assert any(f"{without} views without a mask" in note or f"since {without} others have none" in note for note in scene.notes)


def test_pictures_that_share_a_stem_have_their_suffix_in_the_name(tmp_path: Path) -> None:
    made = colmap.model(LENS, poses(4))
    for number, name in enumerate(("a.jpg", "a.png", "b.jpg", "c.jpg"), 1):
        made.images[number].name = name
    colmap.write(made, tmp_path)
    assert [view.name for view in load_scene(tmp_path).views] == ["a_jpg", "a_png", "b", "c"]


@pytest.mark.parametrize("cloud", ["absent", "points3D.ply"])
def test_a_model_without_points_is_read(tmp_path: Path, cloud: str) -> None:
    colmap.write(colmap.model(LENS, poses(4)), tmp_path)
    (tmp_path / "sparse/0/points3D.bin").unlink()
    if cloud != "absent":
        trimesh.PointCloud(colmap.POINTS).export(tmp_path / "sparse/0" / cloud)
    scene = load_scene(tmp_path)
    assert len(scene.views) == 4 and scene.sightings is None
    if cloud == "absent":
        assert scene.points is None
    else:
        np.testing.assert_allclose(scene.points, colmap.POINTS, atol=1e-6)  # floats


def test_another_programs_cameras_json_beside_a_model_is_not_koalas(tmp_path: Path) -> None:
    """3D Gaussian Splatting writes a list of that name."""
    colmap.write(colmap.model(LENS, poses(4)), tmp_path)
    (tmp_path / "cameras.json").write_text('[{"id": 0, "img_name": "a", "width": 120}]')
    assert load_scene(tmp_path).provenance["format"] == "colmap"


@pytest.mark.parametrize("named", ["NFC", "NFD"])
def test_names_in_two_unicode_forms_are_the_same_name(tmp_path: Path, named: str) -> None:
    """A model with accents in one form, files in the other: by their order alone, "Sz" and "Süd" would be exchanged."""
    made = colmap.model(LENS, poses(4))
    words = ["Süd", "Sz", "Österreich", "Zürich"]
    for number, word in enumerate(words, 1):
        made.images[number].name = unicodedata.normalize(named, f"{word}.JPG")
    colmap.write(made, tmp_path)
    other = "NFD" if named == "NFC" else "NFC"
    for path in list((tmp_path / "images").iterdir()):
        path.rename(path.with_name(unicodedata.normalize(other, path.name)))
    for view in load_scene(tmp_path).views:
        number = 1 + words.index(unicodedata.normalize("NFC", view.name))
        expected = np.roll(photographs.corners(), 5 * number, axis=1)
        assert np.abs(255 * view.read() - expected).mean() < 3  # JPEG; the next picture is off by eight
        assert np.abs(view.world_from_camera - poses(4)[number - 1]).max() < 1e-9


def test_names_that_are_not_utf8_are_refused_by_name(tmp_path: Path) -> None:
    colmap.write(colmap.model(LENS, poses(4)), tmp_path)
    old = b"IMG_0001.JPG"
    path = tmp_path / "sparse/0/images.bin"
    path.write_bytes(path.read_bytes().replace(old, b"IMG_\xfc\xfc01.JPG"))
    import os

    os.rename(os.fsencode(tmp_path / "images" / "IMG_0001.JPG"), os.fsencode(tmp_path / "images") + b"/IMG_\xfc\xfc01.JPG")
    with pytest.raises(DatasetError, match=r"IMG_\\udcfc.*not UTF-8.*rename it|not UTF-8"):
        load_scene(tmp_path)


@pytest.mark.parametrize("second", ["", "# todo\n", "later\n"])
def test_a_missing_line_of_features_is_named(tmp_path: Path, second: str) -> None:
    colmap.write(colmap.model(LENS, poses(4)), tmp_path, text=True)
    path = tmp_path / "sparse/0/images.txt"
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    path.write_text("".join(f"{line}\n{second}" for line in lines[::2]))
    with pytest.raises(DatasetError, match="the line after each image holds its features"):
        load_scene(tmp_path)


@pytest.mark.parametrize(("format", "name"), [("WEBP", "WebP"), ("BMP", "BMP"), ("GIF", "GIF")])
def test_other_kinds_of_pictures_are_named(tmp_path: Path, format: str, name: str) -> None:
    colmap.write(colmap.model(LENS, poses(4)), tmp_path)
    Image.fromarray(photographs.corners()).save(tmp_path / "images" / "IMG_0002.JPG", format=format)
    with pytest.raises(DatasetError, match=f"it is a {name}.*; convert it to PNG or JPEG"):
        load_scene(tmp_path)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("sfm_data.json", "is of OpenMVG"), ("cameras.sfm", "is of Meshroom"),
        ("bundle.out", "is of Bundler"), ("groundtruth.txt", "may hold poses"), ("poses.csv", "may hold poses"),
    ],
)  # fmt: skip
def test_poses_in_files_that_are_not_read_are_named(tmp_path: Path, name: str, said: str) -> None:
    photographs.write(tmp_path / "images/a.png", photographs.corners())
    (tmp_path / name).write_text("{}")
    with pytest.raises(UsageError, match=f"{name} {said}"):
        load_scene(tmp_path)


def test_more_images_than_rows_are_to_be_removed(tmp_path: Path) -> None:
    np.save(tmp_path / "poses_bounds.npy", np.tile([*np.eye(4)[:3, :3].ravel(), *np.zeros(6), 1.0, 2.0], (3, 1)))
    for k in range(4):
        photographs.write(tmp_path / f"images/{k}.png", photographs.corners())
    with pytest.raises(DatasetError, match="remove the images without a row"):
        load_scene(tmp_path)


def test_points_of_a_model_are_those_of_colmap(tmp_path: Path) -> None:
    """Tracks of every length lie between the records."""
    library = pytest.importorskip("pycolmap", reason="pycolmap is absent: it has no wheel for this platform")
    made = colmap.model(LENS, poses(5))
    for row, number in enumerate(list(made.points3D)[:6]):
        for element in list(made.points3D[number].track.elements)[: row % 4]:
            made.delete_observation(element.image_id, element.point2D_idx)
    made.write_binary(tmp_path)
    again = library.Reconstruction(tmp_path)
    model = read_model(*(tmp_path / f"{name}.bin" for name in ("cameras", "images", "points3D")))
    found = {tuple(point.xyz): tuple(point.color) for point in again.points3D.values()}
    assert {tuple(p): tuple(c) for p, c in zip(model.points, model.colours, strict=True)} == found


def test_rotations_of_any_form_come_to_the_same(transforms: Writer) -> None:
    """SciPy's rotation of a pose, as it is read."""
    scene = load_scene(transforms())
    for view, matrix in zip(scene.views, poses(), strict=True):
        turn = Rotation.from_matrix(matrix[:3, :3]).inv() * Rotation.from_matrix(view.world_from_camera[:3, :3])
        assert turn.magnitude() < 1e-9 and pose.difference(view.world_from_camera, matrix)[0] < 1e-12


def test_pixels_without_a_ray_are_counted_or_the_lens_is_refused(tmp_path: Path) -> None:
    """A fisheye of 225 degrees whose rim is dark, and one whose formula holds nowhere."""
    lens = {"OPENCV_FISHEYE": (30.0, 30.0, 60.0, 40.0, 0.0, 0.0, 0.0, 0.0)}
    colmap.write(colmap.model(lens, poses(4)), tmp_path / "wide")
    scene = load_scene(tmp_path / "wide")
    assert any("of the pixels of 4 views have no ray" in note for note in scene.notes)
    assert any("no ray" in finding.why for finding in check(tmp_path / "wide", matches=False))
    lens = {"SIMPLE_RADIAL": (40.0, 60.0, 40.0, -3.0)}
    colmap.write(colmap.model(lens, poses(4)), tmp_path / "none")
    with pytest.raises(DatasetError, match=r"lens is not usable .* can be inverted at \d+% of the pixels"):
        load_scene(tmp_path / "none")


@pytest.mark.parametrize(("suffix", "white"), [(".png", 1), (".jpg", 255)])
def test_masks_of_what_to_ignore_are_read_as_other_masks_are(transforms: Writer, tmp_path: Path, suffix: str, white: int) -> None:
    """Labels instead of white, and the noise of JPEG near black: whether a pixel takes part must not hang on that."""
    gripper = np.full((80, 120), white, np.uint8)
    gripper[64:, 40:80] = 0  # whole blocks of a JPEG
    photographs.write(tmp_path / f"mask{suffix}", gripper)
    for view in load_scene(transforms(frame=lambda k: {"mask_path": f"mask{suffix}"})).views:
        counted = view.counted(view.camera)
        assert counted is not None and np.array_equal(counted, gripper > 0)


def test_masks_of_what_is_in_the_way_hide_pixels_and_no_background(transforms: Writer, tmp_path: Path) -> None:
    """As nerfstudio reads mask_path: a gripper at the lower edge of all pictures of a room."""
    gripper = np.full((80, 120), 255, np.uint8)
    gripper[60:, 40:80] = 0
    photographs.write(tmp_path / "mask.png", gripper)
    scene = load_scene(transforms(frame=lambda k: {"mask_path": "mask.png"}))
    assert (
        scene.background == "scene"
        and scene.bounds_from.startswith("cameras")
        and "masks are white at all edges" in scene.notes[-1]
    )
    for view in scene.views:
        counted = view.counted(view.camera)
        assert view.mask is None and counted is not None and np.array_equal(counted, gripper > 0)
    for format in ("koala", "nerfstudio", "colmap"):
        save_scene(scene, tmp_path / format, format)
        view = load_scene(tmp_path / format).views[0]
        assert view.mask is None and np.array_equal(view.counted(view.camera), gripper > 0)
    assert "pixels that are to be ignored" in save_scene(scene, tmp_path / "blender", "blender")
