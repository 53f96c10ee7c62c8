"""Scenes made from scenes see the same world along the same rays."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.edit import edit
from koala3d.datasets.formats import koala, load_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, Sightings

LENS = Camera(96, 72, 90.0, 91.0, 50.3, 34.1, k1=-0.12, k2=0.05, p1=1e-3, p2=-8e-4, k3=0.01)


def with_sightings(scene: Scene) -> Scene:
    """Five points near the middle, seen by every view where it would see them."""
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (5, 3))
    index, pixels = [], []
    for number, view in enumerate(scene.views):
        local = (points - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
        index += [[point, number] for point in range(5)]
        pixels.append(view.camera.project(local))
    seen = Sightings(tuple(v.name for v in scene.views), np.array(index), np.concatenate(pixels))
    return replace(scene, points=points, colours=np.arange(15, dtype=np.uint8).reshape(5, 3), sightings=seen)


def assert_sightings_fit(scene: Scene) -> None:
    """Every sighting is where its view projects its point."""
    seen, views = scene.sightings, {view.name: view for view in scene.views}
    assert seen is not None and scene.points is not None and len(seen.index) > 20
    for (point, number), pixel in zip(seen.index, seen.pixels, strict=True):
        view = views[seen.names[number]]
        local = (scene.points[point] - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
        assert np.abs(view.camera.project(local) - pixel).max() < 1e-6


def test_subset_and_split(make_scene: Callable[..., Scene]) -> None:
    scene = make_scene()
    assert [v.name for v in edit.subset(scene, every=4).views] == ["000", "004", "008"]
    assert [v.name for v in edit.subset(scene, keep="00[12]").views] == ["001", "002"]
    assert {v.split for v in edit.subset(scene, splits=("test",)).views} == {"test"}
    with pytest.raises(UsageError, match="no view is left"):
        edit.subset(scene, keep="x*")
    with pytest.raises(UsageError, match="must be 1 or more"):
        edit.subset(scene, every=0)
    assert [v.name for v in edit.split(scene, every=3).split("test")] == ["000", "003", "006"]
    new = edit.split(scene, test="00[01]", val="008")
    assert [len(new.split(name)) for name in ("train", "val", "test")] == [6, 1, 2]
    with pytest.raises(UsageError, match=r"no view matches \(pattern of val\)"):
        edit.split(scene, test="000", val="nothing")


def test_merge_keeps_names_apart_and_points_together(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    scene = with_sightings(make_scene())
    first, second = edit.subset(scene, every=2), replace(edit.subset(scene, keep="00[0-3]"), name="other")
    merged = edit.merge([first, second], "both")
    names = [view.name for view in merged.views]
    assert names == ["little/000", "little/002", "004", "006", "008", "other/000", "001", "other/002", "003"]
    assert merged.points is not None and len(merged.points) == 10
    koala.save(merged, tmp_path / "both")
    again = load_scene(tmp_path / "both")
    assert [view.name for view in again.views] == names and again.sightings is not None
    seen_by = {again.sightings.names[view] for point, view in again.sightings.index if point >= 5}
    assert "other/000" in seen_by and "little/000" not in seen_by
    with pytest.raises(UsageError, match="scenes differ in background"):
        edit.merge([first, replace(second, background="white")], "both")
    with pytest.raises(UsageError, match="at least two scenes"):
        edit.merge([first], "alone")


def test_downscaled(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    scene = with_sightings(make_scene(LENS, mask=True))
    small = edit.downscaled(scene, 3, tmp_path / "small")
    for old, new in zip(scene.views, small.views, strict=True):
        assert (new.camera.width, new.camera.height, new.camera.fx) == (32, 24, 30.0)
        expected = images.resize(old.read_image(), 32, 24)
        assert np.abs(new.read_image() - expected).max() < 0.51 / 255
        if old.truth:
            assert np.allclose(new.read_truth("depth"), 0.4, atol=1e-6)
            assert np.allclose(new.read_truth("normals"), old.read_truth("normals")[0, 0], atol=1e-6)
    assert_sightings_fit(small)
    with pytest.raises(UsageError, match="2 or more"):
        edit.downscaled(scene, 1, tmp_path / "none")


def test_undistorted(make_scene: Callable[..., Scene], far_wall: Callable, tmp_path: Path) -> None:
    flat = edit.undistorted(with_sightings(make_scene(LENS)), tmp_path / "flat")
    assert all(view.camera.is_centred for view in flat.views)
    view = flat.views[3]
    assert (
        np.abs(view.read() - far_wall(view.camera, view.world_from_camera)).max() < 1.8 / 255
    )  # two roundings to 8 bits, and positions to a 64th of a pixel
    assert_sightings_fit(flat)


def test_cropped_keeps_pixels_and_rays(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    scene = with_sightings(make_scene(LENS, mask=True))
    part = edit.cropped(scene, 10, 5, 60, 50, tmp_path / "part")
    for old, new in zip(scene.views, part.views, strict=True):
        assert np.array_equal(new.read(), old.read()[5:55, 10:70])
        rays = new.camera.directions(new.camera.pixel_centres())
        assert np.abs(rays - old.camera.directions(old.camera.pixel_centres())[5:55, 10:70]).max() < 1e-12
        assert all(np.array_equal(new.read_truth(key), old.read_truth(key)[5:55, 10:70]) for key in old.truth)
    assert_sightings_fit(part)
    with pytest.raises(UsageError, match=r"60x50 at \(50, 5\) of 96x72"):
        edit.cropped(scene, 50, 5, 60, 50, tmp_path / "none")
