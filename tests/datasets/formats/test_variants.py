"""Folders as they are in the wild: renamed, linked, re-encoded, scaled. Each reads like the folder that it was made from."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats import colmap, load_scene, save_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene
from tests.foreign import colmap as foreign_colmap
from tests.foreign import photographs

LENS = Camera(96, 72, 90.0, 90.0, 48.0, 36.0)
HOME = {"koala": "images", "nerfstudio": "images", "llff": "images", "dtu": "image", "colmap": "images"}
MASKS = {**dict.fromkeys(HOME, "masks"), "dtu": "mask"}


@pytest.fixture
def foreign(make_scene: Callable[..., Scene], tmp_path: Path) -> Callable[..., Path]:
    """Factory of a folder of nine masked views in a layout, without what only Koala writes."""

    def make(layout: str, *, mask: bool = True, sizes: tuple[int, ...] = ()) -> Path:
        save_scene(make_scene(LENS, truth=False, mask=mask), tmp_path / "scene", layout, sizes=sizes)
        (tmp_path / "scene" / "koala.json").unlink(missing_ok=True)
        return tmp_path / "scene"

    return make


def same(one: Scene, other: Scene, *, tolerance: float = 0.0) -> None:
    assert [view.split for view in one.views] == [view.split for view in other.views]
    for a, b in zip(one.views, other.views, strict=True):
        assert a.camera == b.camera and np.abs(a.world_from_camera - b.world_from_camera).max() < 1e-12
        assert np.abs(a.read() - b.read()).max() <= tolerance
    assert one.background == other.background and np.abs(one.box - other.box).max() < (0.02 if tolerance else 1e-9)


def renamed(folder: Path, home: str, change: Callable[[Path], str]) -> None:
    for path in sorted((folder / home).iterdir()):
        path.rename(path.with_name(change(path)))


def as_jpeg(folder: Path, home: str, suffix: str) -> None:
    for path in sorted((folder / home).iterdir()):
        photographs.write(path.with_suffix(suffix), photographs.shown(path))
        path.unlink()


def inverted(folder: Path, home: str) -> None:
    for path in sorted((folder / home).iterdir()):
        images.write(path, 1 - images.read(path))


def coloured(folder: Path, home: str) -> None:
    """Red on transparent white."""
    for path in sorted((folder / home).iterdir()):
        mask = images.read(path)
        images.write(path, np.concatenate([np.ones_like(mask), 1 - mask, 1 - mask, mask], axis=-1))


def labelled(folder: Path, home: str) -> None:
    for path in sorted((folder / home).iterdir()):
        images.write(path, (images.read(path) > 0).astype(np.uint8))


@pytest.mark.parametrize("layout", ["llff", "dtu", "colmap"])
@pytest.mark.parametrize(
    "change",
    [
        lambda folder, home, masks: (folder / home).rename(folder / "rgb"),
        lambda folder, home, masks: (folder / home).rename(folder / ("images" if home == "image" else "image")),
        lambda folder, home, masks: renamed(folder, home, lambda path: path.stem + ".PNG"),
        lambda folder, home, masks: (folder / masks).rename(folder / ("masks" if masks == "mask" else "mask")),
        lambda folder, home, masks: (folder / masks).rename(folder / "alpha"),
        lambda folder, home, masks: renamed(folder, masks, lambda path: f"{path.name.split('.')[0]}.PNG"),
        lambda folder, home, masks: renamed(folder, masks, lambda path: f"{path.name.split('.')[0]}.png.png"),
        lambda folder, home, masks: inverted(folder, masks),
        lambda folder, home, masks: coloured(folder, masks),
        lambda folder, home, masks: labelled(folder, masks),
    ],
    ids=["rgb", "image for images", "upper case", "mask", "alpha", "X.PNG", "X.png.png", "inverted", "colours", "labels"],
)
def test_variants_read_like_the_original(foreign: Callable[..., Path], layout: str, change: Callable[..., None]) -> None:
    folder = foreign(layout)
    before = load_scene(folder)
    kept = [view.read() for view in before.views]
    change(folder, HOME[layout], MASKS[layout])
    after = load_scene(folder)
    assert after.background == "white" and np.abs(after.box - before.box).max() < 1e-9
    for view, old, pixels in zip(after.views, before.views, kept, strict=True):
        assert view.camera == old.camera and np.array_equal(view.world_from_camera, old.world_from_camera)
        assert np.array_equal(view.read(), pixels)


@pytest.mark.parametrize("layout", ["llff", "dtu", "colmap", "nerfstudio"])
def test_lossy_masks_beside_upper_case_images(foreign: Callable[..., Path], layout: str) -> None:
    """X.jpg beside X.JPG; the colours of the images differ by their own compression."""
    folder = foreign(layout)
    before = load_scene(folder)
    alpha = [view.read()[..., 3] for view in before.views]
    if layout == "nerfstudio":
        content = json.loads((folder / "transforms.json").read_text())
        for frame in content["frames"]:
            del frame["mask_path"]
        (folder / "transforms.json").write_text(json.dumps(content))
    as_jpeg(folder, HOME[layout], ".JPG")
    if layout == "colmap":
        renamed(folder, "masks", lambda path: f"{path.name.split('.')[0]}.png")
    as_jpeg(folder, MASKS[layout], ".jpg")
    after = load_scene(folder)
    assert [view.image.suffix for view in after.views] == [".JPG"] * 9
    for view, old in zip(after.views, alpha, strict=True):
        found = view.read()[..., 3]
        assert np.abs(found - old).max() < 0.5 and ((found > 0) & (old == 0)).mean() < 0.01  # no halo that a hull would keep
    assert np.abs(after.box - before.box).max() < 0.02


@pytest.mark.parametrize("layout", ["koala", "llff", "colmap"])
def test_masks_that_are_not_scaled_with_the_images(foreign: Callable[..., Path], layout: str) -> None:
    folder = foreign(layout, sizes=(2,))
    expected = load_scene(folder, images="images_2")
    kept = [view.read() for view in expected.views]
    shutil.rmtree(folder / "masks_2")
    found = load_scene(folder, images="images_2")
    for view, old in zip(found.views, kept, strict=True):
        assert view.read().shape == (36, 48, 4) and np.abs(view.read() - old).max() < 1 / 255  # rounded once less


@pytest.mark.parametrize("written", ["koala", "nerfstudio", "blender", "colmap", "dtu", "llff"])
def test_odd_masks_are_written_as_others_expect_them(foreign: Callable[..., Path], tmp_path: Path, written: str) -> None:
    folder = foreign("llff")
    inverted(folder, "masks")
    before = load_scene(folder)
    assert all(view.mask_inverted for view in before.views) and any("object in black" in note for note in before.notes)
    save_scene(before, tmp_path / "out", written)
    after = load_scene(tmp_path / "out")
    assert not any(view.mask_inverted for view in after.views)
    for view, old in zip(after.views, before.views, strict=True):
        assert np.array_equal(view.read()[..., 3], old.read()[..., 3])
        assert view.mask is None or np.array_equal(images.read(view.mask)[..., 0], old.read()[..., 3])


@pytest.mark.parametrize("layout", HOME)
def test_a_scene_of_links_reads_like_its_source(foreign: Callable[..., Path], tmp_path: Path, layout: str) -> None:
    """The folder is a link to a folder in which every folder of images is one, and every file in those."""
    folder = foreign(layout)
    before = load_scene(folder)
    linked = tmp_path / "linked"
    linked.mkdir()
    for path in folder.iterdir():
        (linked / path.name).symlink_to(path)
    home = linked / HOME[layout]
    home.unlink()
    (tmp_path / "elsewhere").mkdir()
    for path in (folder / HOME[layout]).iterdir():
        (tmp_path / "elsewhere" / path.name).symlink_to(path)
    home.symlink_to(tmp_path / "elsewhere")
    (tmp_path / "entry").symlink_to(linked)
    after = load_scene(tmp_path / "entry")
    same(after, before)
    save_scene(after, tmp_path / "out", "koala")
    assert not any(path.is_symlink() for path in (tmp_path / "out").rglob("*"))


@pytest.mark.parametrize("name", ["cameras.npz", "cameras_large.npz"])
def test_dtu_cameras_of_other_names(foreign: Callable[..., Path], name: str) -> None:
    folder = foreign("dtu")
    before = load_scene(folder)
    (folder / "cameras_sphere.npz").rename(folder / name)
    same(load_scene(folder), before)


def test_dtu_images_that_are_left_out_keep_their_cameras(foreign: Callable[..., Path]) -> None:
    folder = foreign("dtu")
    before = {view.name: view for view in load_scene(folder).views}
    for number in (0, 4):
        (folder / "image" / f"{number:06d}.png").unlink()
    after = load_scene(folder).views
    assert len(after) == 7
    for view in after:
        assert np.array_equal(view.world_from_camera, before[view.name].world_from_camera)
        assert np.array_equal(view.read(), before[view.name].read())
    renamed(folder, "image", lambda path: f"photo{chr(97 + int(path.stem))}{path.suffix}")
    with pytest.raises(DatasetError, match="9 cameras, 7 images whose names do not say which is which"):
        load_scene(folder)


@pytest.mark.parametrize("place", ["sparse", "colmap/sparse/0", "colmap", "dense/0/sparse", "."])
def test_models_in_other_places(foreign: Callable[..., Path], place: str) -> None:
    folder = foreign("colmap")
    before = load_scene(folder)
    shutil.move(folder / "sparse" / "0", folder / "model")
    (folder / "sparse").rmdir()
    (folder / place).mkdir(parents=True, exist_ok=True)
    for path in (folder / "model").iterdir():
        path.rename(folder / place / path.name)
    (folder / "model").rmdir()
    same(load_scene(folder), before)


@pytest.mark.parametrize("text", [False, True])
def test_the_largest_of_several_models_is_used(make_scene: Callable[..., Scene], tmp_path: Path, text: bool) -> None:
    scene = make_scene(LENS, truth=False)
    small = replace(scene, views=scene.views[:2])
    colmap.save(small, tmp_path / "small", text=text)
    colmap.save(scene, tmp_path / "scene", text=text)
    (tmp_path / "scene" / "koala.json").unlink()
    (tmp_path / "scene" / "sparse" / "0").rename(tmp_path / "scene" / "sparse" / "1")
    shutil.copytree(tmp_path / "small" / "sparse" / "0", tmp_path / "scene" / "sparse" / "0")
    found = load_scene(tmp_path / "scene")
    assert len(found.views) == 9
    assert found.notes == ("the largest of 2 models is used: sparse/1 has 9 images, sparse/0 has 2",)


def test_images_of_a_model_under_their_order(foreign: Callable[..., Path]) -> None:
    """LLFF's images_N have names of their own."""
    folder = foreign("colmap", mask=False, sizes=(2,))
    expected = load_scene(folder, images="images_2")
    renamed(folder, "images_2", lambda path: f"image{path.stem}.png")
    found = load_scene(folder, images="images_2")
    assert any("taken in the order of names" in note for note in found.notes)
    for view, old in zip(found.views, expected.views, strict=True):
        assert view.camera == old.camera and view.image.name == f"image{old.name}.png"


@pytest.mark.parametrize("text", [False, True])
def test_a_models_names_may_begin_with_the_folder(tmp_path: Path, text: bool) -> None:
    made = foreign_colmap.model({"PINHOLE": [110.0, 110.0, 60.0, 40.0]}, foreign_colmap.ring(9))
    foreign_colmap.write(made, tmp_path, text=text)
    before = load_scene(tmp_path)
    for image in made.images.values():
        image.name = f"images/{image.name}"
    (made.write_text if text else made.write_binary)(tmp_path / "sparse" / "0")
    found = load_scene(tmp_path)
    assert [view.image.parent.name for view in found.views] == ["images"] * 9
    assert [view.name for view in found.views] == [f"images/{view.name}" for view in before.views]
    for view, old in zip(found.views, before.views, strict=True):
        assert np.array_equal(view.read(), old.read()) and np.array_equal(view.world_from_camera, old.world_from_camera)
