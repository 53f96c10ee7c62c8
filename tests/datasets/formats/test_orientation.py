"""Pictures with EXIF orientations in folders of other programs: poses belong to the stored pixels, exports carry no tag."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats import load_scene, save_scene
from tests.foreign import colmap, photographs

pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is absent: it has no wheel for this platform")

WIDTH, HEIGHT = 120, 80
LENS = {"PINHOLE": (90.0, 90.0, 60.0, 40.0)}
JPEG = 2
"""Steps of 255 by which decoders differ."""


def folder_of(path: Path, orientation: int) -> Path:
    """A model by pycolmap whose pictures say that they are turned; the stored ones have the cameras' size."""
    colmap.write(colmap.model(LENS, colmap.ring(4)), path)
    size = (HEIGHT, WIDTH) if orientation >= 5 else (WIDTH, HEIGHT)
    for picture in (path / "images").iterdir():
        photographs.write(picture, photographs.corners(*size), orientation=orientation)
    return path


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_views_have_the_pixels_that_colmap_sees(tmp_path: Path, orientation: int) -> None:
    scene = load_scene(folder_of(tmp_path, orientation))
    assert len(scene.views) == 4
    assert "4 images have an EXIF orientation, which is not followed: poses belong to the stored pixels" in scene.notes
    for view in scene.views:
        theirs = pycolmap.Bitmap.read(view.image, as_rgb=True).to_array()
        assert np.abs(255 * view.read() - theirs).max() <= JPEG


@pytest.mark.parametrize("format", ["colmap", "nerfstudio", "blender", "llff", "koala"])
def test_what_is_written_has_no_orientation(tmp_path: Path, format: str) -> None:
    """Whether or not a program follows the tag, it sees the size that the file states and the pixels that were stored."""
    scene = load_scene(folder_of(tmp_path / "a", 6))
    save_scene(scene, tmp_path / "b", format)
    written = sorted(path for path in (tmp_path / "b").rglob("*") if path.suffix.lower() in (".jpg", ".png"))
    assert len(written) == 4
    for path, view in zip(written, scene.views, strict=True):
        with Image.open(path) as picture:
            assert picture.size == (WIDTH, HEIGHT) and picture.getexif().get(0x112, 1) == 1
        assert np.abs(photographs.shown(path)[..., :3] - 255 * view.read()[..., :3]).max() <= JPEG


@pytest.mark.parametrize("format", ["colmap", "nerfstudio", "blender", "llff", "koala"])
def test_an_exported_picture_can_be_edited_without_changing_the_original(tmp_path: Path, format: str) -> None:
    scene = load_scene(folder_of(tmp_path / "a", 1))
    before = {view.image: view.image.read_bytes() for view in scene.views}
    save_scene(scene, tmp_path / "b", format)
    for path in (tmp_path / "b").rglob("*"):
        if path.suffix.lower() in (".jpg", ".png"):
            with open(path, "r+b") as file:
                file.write(b"edited")
    assert all(path.read_bytes() == content for path, content in before.items())


def test_a_scene_of_koalas_is_linked_within_koala_only(tmp_path: Path) -> None:
    """A second scene of the same pictures takes no room; an export is somebody else's."""
    save_scene(load_scene(folder_of(tmp_path / "a", 1)), tmp_path / "b", "koala")
    scene = load_scene(tmp_path / "b")
    save_scene(scene, tmp_path / "c", "koala")
    save_scene(scene, tmp_path / "d", "colmap")
    assert all(view.image.stat().st_nlink == 2 for view in load_scene(tmp_path / "c").views)
    assert all(path.stat().st_nlink == 1 for path in (tmp_path / "d" / "images").iterdir())


def test_pictures_for_upright_poses_are_refused_with_the_remedy(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, 1)
    for picture in (folder / "images").iterdir():
        photographs.write(picture, photographs.corners(), orientation=6)
    with pytest.raises(DatasetError, match=r"another shape.*80x120.*120x80.*EXIF orientation is not followed"):
        load_scene(folder)


def test_nerfstudio_frames_are_read_as_they_are_stored(tmp_path: Path) -> None:
    save_scene(load_scene(folder_of(tmp_path / "a", 1)), tmp_path / "b", "nerfstudio")
    content = json.loads((tmp_path / "b" / "transforms.json").read_text())
    for frame in content["frames"]:
        photographs.write(tmp_path / "b" / frame["file_path"], photographs.corners(), orientation=3)
    (tmp_path / "b" / "koala.json").unlink()
    view = load_scene(tmp_path / "b").views[0]
    with Image.open(view.image) as picture:
        assert np.abs(255 * view.read() - np.asarray(picture)).max() <= JPEG
