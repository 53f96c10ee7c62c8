"""Every real set loads, and its trap is named."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.formats import load_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene
from koala3d.datasets.structure.bounds import corners
from koala3d.datasets.structure.measure import measured

Folder = Callable[[str], Path]


loaded = cache(load_scene)


def counts(scene: Scene) -> tuple[int, int]:
    return len(scene.split("train")), len(scene.split("test"))


def test_lego(real_data: Folder) -> None:
    scene = loaded(real_data("lego400"))
    assert counts(scene) == (100, 25) and scene.background == "white" and scene.notes == ()
    view = scene.views[0]
    assert view.camera.is_centred and view.camera.fx == pytest.approx(555.5555, abs=1e-3)  # 0.5 * 400 / tan(0.3455556)
    assert view.read().shape == (400, 400, 4)
    assert scene.near >= 2 and scene.far <= 6  # the bounds that NeRF's own code uses for these scenes
    assert (scene.box[0] >= -1.35).all() and (scene.box[1] <= 1.35).all()
    assert (scene.box[0] <= [-0.6, -1.1, -0.4]).all() and (scene.box[1] >= [0.6, 1.1, 1.0]).all()  # the excavator's own extent


def test_lego_poses_agree_with_the_images(real_data: Folder) -> None:
    """The object's box, projected, holds the object's pixels and not many more: OpenGL axes were turned the right way."""
    scene = loaded(real_data("lego400"))
    for view in scene.views[::25]:
        local = (corners(scene.box) - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
        projected = view.camera.project(local)
        rows, columns = np.nonzero(view.read()[..., 3] > 0.5)
        low, high = projected.min(0), projected.max(0)
        assert (low <= [columns.min(), rows.min()]).all() and (high >= [columns.max() + 1, rows.max() + 1]).all()
        assert np.prod(high - low) < 2.5 * np.ptp(rows) * np.ptp(columns)  # perspective widens a box's corners


def test_fox_is_measured_on_request(real_data: Folder) -> None:
    """Photographs of a wall and a head before it, 2 to 8 units away: found by a triangulation of another kind, once.

    Every second one is looked at.
    """
    scene = load_scene(real_data("fox"))
    scene = measured(scene.with_views(scene.views[::2]))
    assert 1.2 < scene.near < 1.9 and 14 < scene.far < 18 and scene.points is not None and len(scene.points) > 800
    inner, outer = np.array([[-0.9, -1.6, -3.2], [1.9, 1.2, 2.9]]), np.array([[-1.6, -2.6, -4.6], [2.6, 2.1, 3.7]])
    assert (outer[0] <= scene.box[0]).all() and (scene.box[0] <= inner[0]).all()
    assert (inner[1] <= scene.box[1]).all() and (scene.box[1] <= outer[1]).all()


def test_fox_names_the_17_missing_files(real_data: Folder) -> None:
    scene = load_scene(real_data("fox"))
    assert counts(scene) == (43, 7) and scene.background == "scene" and scene.far == np.inf
    assert "17 of 67 images" in scene.notes[0] and "images/0005.jpg" in scene.notes[0]
    camera = scene.views[0].camera
    assert (camera.width, camera.height, camera.cx) == (1080, 1920, 554.558)
    assert (camera.k1, camera.k2, camera.p1, camera.p2) == (0.0578421, -0.0805099, -0.000980296, 0.00015575)
    assert scene.split("test")[1].name == sorted(v.name for v in scene.views)[8]


def test_mold_gold_cape_scales_its_intrinsics_and_masks(real_data: Folder) -> None:
    scene = load_scene(real_data("mold_gold_cape"))
    assert counts(scene) == (104, 15) and scene.background == "white"
    assert "3648x3648" in scene.notes[0] and "640x640" in scene.notes[0]
    camera = scene.views[0].camera
    assert camera.fx == camera.fy == pytest.approx(7689.22992416 * 640 / 3648) and camera.is_centred
    picture = scene.views[0].read()
    assert picture.shape == (640, 640, 4) and 0.4 < picture[..., 3].mean() < 0.6
    assert scene.near == pytest.approx(1.7123296340843293)  # as the file states
    assert 5 < scene.far < 6.5  # the file says 13.35; the hull of the masks ends before
    object_box = np.array([[-0.81, 0.49, 0.21], [0.67, 1.80, 1.99]])  # about points triangulated from the photographs
    assert (scene.box[0] <= object_box[0]).all() and (scene.box[1] >= object_box[1]).all()
    assert (scene.box[1] - scene.box[0] < object_box[1] - object_box[0] + 0.35).all() and "masks" in scene.bounds_from


def test_fern_says_that_its_model_lacks_a_file(real_data: Folder) -> None:
    scene = load_scene(real_data("llff_fern"))
    assert counts(scene) == (17, 3) and (scene.views[0].camera.width, scene.views[0].camera.height) == (504, 378)
    assert any("images.bin" in note for note in scene.notes) and any("4032x3024" in note for note in scene.notes)
    forward = np.stack([v.world_from_camera[:3, 2] for v in scene.views])
    assert (forward @ forward.mean(0) > 0.95).all()  # faces forward: LLFF's axes were turned the right way
    with pytest.raises(DatasetError, match=r"images\.bin is missing"):
        load_scene(real_data("llff_fern"), format="colmap")


def test_colmap_reprojects_its_own_points(real_data: Folder) -> None:
    """The stated mean error is 0.30 px over 5,931 observations, here of the undistorted model."""
    scene = load_scene(real_data("colmap_small") / "dense")
    assert len(scene.views) == 23 and scene.points is not None and len(scene.points) == 1443
    view = scene.views[0]
    local = (scene.points - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
    pixels = view.camera.project(local[local[:, 2] > 0])
    inside = ((pixels > 0) & (pixels < [view.camera.width, view.camera.height])).all(1)
    assert inside.mean() > 0.9
    assert view.read().shape == (view.camera.height, view.camera.width, 3)


def test_colmap_small_takes_the_model_that_has_images(real_data: Folder) -> None:
    """`sparse/0` is of images that are not there; those of `dense/sparse` are."""
    assert len(load_scene(real_data("colmap_small")).views) == 23


@pytest.mark.parametrize("name", ["visp_franka_handeye", "franka_charuco_handeye"])
def test_folders_without_a_scene_are_refused(real_data: Folder, name: str) -> None:
    with pytest.raises(UsageError, match="holds no scene in a known format"):
        load_scene(real_data(name))


def test_dtu_scales_its_matrices_and_sees_its_object(real_data: Folder) -> None:
    """The stated trap: matrices for 1600x1200, images of 800x600. The centre of the unit sphere lies in every mask's middle."""
    scene = load_scene(real_data("dtu_scan37"))
    assert counts(scene) == (42, 7) and "1600x1200" in scene.notes[0] and scene.background == "white"
    camera = scene.views[0].camera
    assert (camera.width, camera.height) == (800, 600) and abs(camera.cx - 400) < 20 and abs(camera.cy - 300) < 20
    with np.load(real_data("dtu_scan37") / "cameras_sphere.npz") as stored:
        for index, view in enumerate(scene.views):
            projected = stored[f"world_mat_{index}"] @ [10.0, 20.0, 700.0, 1.0]  # any point: K [R | t] was taken apart rightly
            local = (np.array([10.0, 20.0, 700.0]) - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
            theirs = (projected[:2] / projected[2] + 0.5) / 2  # OpenCV's origin, twice the size
            assert np.abs(view.camera.project(local) - theirs).max() < 0.3  # skew of the file's matrices is left out
    assert view.read().shape == (600, 800, 4)


@pytest.mark.slow
def test_dtu_with_other_names_and_inverted_masks(real_data: Folder, tmp_path: Path) -> None:
    """Links to the set's own images under other names; twelve of its masks, white around the object, at half their size."""
    source, linked = real_data("dtu_scan37"), tmp_path / "scan37"
    before = load_scene(source)
    (linked / "masks").mkdir(parents=True)
    (linked / "cameras_large.npz").symlink_to(source / "cameras_large.npz")
    (tmp_path / "photographs").mkdir()
    for view in before.views[::4]:
        (tmp_path / "photographs" / f"{view.name}{view.image.suffix.upper()}").symlink_to(view.image)
        images.write(linked / "masks" / f"{view.name}.jpg", 1 - images.resize(view.read_mask(), 400, 300, srgb=False))
    (linked / "images").symlink_to(tmp_path / "photographs")
    after = load_scene(linked)
    assert after.background == "white" and any("object in black" in note for note in after.notes)
    for view, old in zip(after.views, before.views[::4], strict=True):
        assert view.name == old.name and view.camera == old.camera
        assert np.abs(view.world_from_camera - old.world_from_camera).max() < 1e-9
        assert np.abs(view.read()[..., 3] - old.read()[..., 3]).mean() < 0.02  # edges at half the size
