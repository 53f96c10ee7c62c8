"""A scene that is exported and read again is the same scene."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.formats import blender, colmap, koala, llff, load_scene, nerfstudio
from koala3d.datasets.formats.sidecar import FILE as SIDECAR
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, Sightings
from koala3d.datasets.spline import Grid, Spline

LENS = Camera(96, 72, 90.0, 91.0, 50.3, 34.1, k1=-0.12, k2=0.05, p1=1e-3, p2=-8e-4, k3=0.01)
GRID = Grid(-0.9, -0.75, 0.25, 0.25, 8, 7)
SPLINED = replace(LENS, spline=Spline(GRID, tuple(np.random.default_rng(0).normal(0, 5e-3, 2 * GRID.count).tolist())))
"""A lens whose knots move pixels by half a pixel."""
WRITERS = {"blender": blender.save, "llff": llff.save}
EXACT = 1e-6
"""Poses and rays in double precision; a JSON number or an array element loses nothing."""


def same_facts(a: Scene, b: Scene) -> None:
    assert (a.name, a.near, a.far, a.background, a.metric, a.provenance) == (
        b.name,
        b.near,
        b.far,
        b.background,
        b.metric,
        b.provenance,
    )
    assert np.array_equal(a.box, b.box)
    assert [(v.name, v.split, sorted(v.truth)) for v in a.views] == [(v.name, v.split, sorted(v.truth)) for v in b.views]


def same_rays(a: Scene, b: Scene) -> None:
    for one, other in zip(a.views, b.views, strict=True):
        assert np.abs(one.world_from_camera - other.world_from_camera).max() < EXACT
        rays = [v.camera.directions(v.camera.pixel_centres()) @ v.world_from_camera[:3, :3].T for v in (one, other)]
        assert np.abs(rays[0] - rays[1]).max() < EXACT


@pytest.mark.parametrize("camera", [None, LENS, SPLINED])
@pytest.mark.parametrize("mask", [False, True])
def test_koala_keeps_everything_to_the_bit(
    make_scene: Callable[..., Scene], tmp_path: Path, camera: Camera | None, mask: bool
) -> None:
    scene = make_scene(*([camera] if camera else []), mask=mask)
    scene = replace(scene, points=np.random.default_rng(0).normal(size=(20, 3)), notes=("a note",))
    koala.save(scene, tmp_path / "koala")
    again = load_scene(tmp_path / "koala")
    same_facts(scene, again)
    assert again.notes == scene.notes and np.array_equal(again.points, scene.points)
    for one, other in zip(scene.views, again.views, strict=True):
        assert one.camera == other.camera
        assert np.abs(one.world_from_camera - other.world_from_camera).max() < 1e-15
        assert one.image.read_bytes() == other.image.read_bytes()
        assert np.array_equal(one.read(), other.read()) and one.read().shape[-1] == (4 if mask else 3)
        assert all(np.array_equal(one.read_truth(key), other.read_truth(key)) for key in one.truth)


@pytest.mark.parametrize("layout", WRITERS)
def test_a_centred_pinhole_is_exported_to_the_bit(make_scene: Callable[..., Scene], tmp_path: Path, layout: str) -> None:
    scene = make_scene()
    limits = WRITERS[layout](scene, tmp_path / "out")
    assert "resampled" not in limits and "koala.json" in limits
    again = load_scene(tmp_path / "out", format=layout)
    same_facts(scene, again)
    same_rays(scene, again)
    for one, other in zip(scene.views, again.views, strict=True):
        assert one.image.read_bytes() == other.image.read_bytes() and one.camera == other.camera
        assert all(np.array_equal(one.read_truth(key), other.read_truth(key)) for key in one.truth)
    koala.save(again, tmp_path / "koala")  # and back
    same_rays(scene, load_scene(tmp_path / "koala"))


@pytest.mark.parametrize("layout", WRITERS)
def test_masks_survive(make_scene: Callable[..., Scene], tmp_path: Path, layout: str) -> None:
    """As alpha in Blender's layout, as masks/ in LLFF's; colours under the mask stay as they were."""
    scene = make_scene(mask=True)
    WRITERS[layout](scene, tmp_path / "out")
    again = load_scene(tmp_path / "out")
    for one, other in zip(scene.views, again.views, strict=True):
        assert np.array_equal(one.read(), other.read())


@pytest.mark.parametrize("layout", WRITERS)
def test_a_lens_is_resampled_to_the_same_world(
    make_scene: Callable[..., Scene], far_wall: Callable, tmp_path: Path, layout: str
) -> None:
    scene = make_scene(LENS)
    limits = WRITERS[layout](scene, tmp_path / "out")
    assert "9 views were resampled to centred pinholes" in limits
    again = load_scene(tmp_path / "out")
    same_facts(scene, again)
    for one, other in zip(scene.views, again.views, strict=True):
        assert other.camera.is_centred and np.array_equal(one.world_from_camera[:3, 3], other.world_from_camera[:3, 3])
        error = np.abs(other.read() - far_wall(other.camera, other.world_from_camera))
        assert error.max() < 2 / 255  # two roundings to 8 bits, and positions to a 64th of a pixel
        if one.truth:
            assert np.allclose(other.read_truth("normals"), -one.world_from_camera[:3, 2], atol=1e-6)  # world frame: unchanged
            corner = other.read_truth("depth")[0, 0, 0]
            assert 0.3 < corner < 0.5 and corner != pytest.approx(0.4, abs=1e-4)  # along the turned axis


@pytest.mark.parametrize("layout", [blender, colmap, llff, nerfstudio])
def test_a_splined_lens_is_resampled_where_a_format_lacks_it(
    make_scene: Callable[..., Scene], far_wall: Callable, tmp_path: Path, layout: ModuleType
) -> None:
    scene = make_scene(SPLINED)
    assert "9 views were resampled to centred pinholes" in layout.save(scene, tmp_path / "out")
    again = load_scene(tmp_path / "out")
    for other in again.views:
        assert other.camera.is_centred
        error = np.abs(other.read() - far_wall(other.camera, other.world_from_camera))
        assert error.max() < 2 / 255  # two roundings to 8 bits, and positions to a 64th of a pixel


def test_sightings_move_with_the_picture(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    scene = make_scene(SPLINED)
    view = scene.views[0]
    seen = np.array([[20.5, 30.25], [60.0, 40.0], [1.0, 1.0]])  # the last one lies outside what is left of the picture
    points = view.camera.directions(seen) @ view.world_from_camera[:3, :3].T + view.world_from_camera[:3, 3]
    index = np.array([[0, 0], [1, 0], [2, 0]])
    colmap.save(replace(scene, points=points, sightings=Sightings((view.name,), index, seen)), tmp_path / "out")
    again = load_scene(tmp_path / "out")
    placed = next(v for v in again.views if v.name == view.name)
    rows = again.sightings.index[:, 1] == again.sightings.names.index(view.name)
    local = (again.points[again.sightings.index[rows, 0]] - placed.world_from_camera[:3, 3]) @ placed.world_from_camera[:3, :3]
    assert rows.sum() == 2
    np.testing.assert_allclose(again.sightings.pixels[rows], placed.camera.project(local), atol=1e-6)


def test_blender_without_sidecar_still_has_cameras_splits_and_shiny_truth(
    make_scene: Callable[..., Scene], tmp_path: Path
) -> None:
    """What another program sees: the field of view alone, and Shiny Blender's maps beside the images."""
    scene = make_scene()
    blender.save(scene, tmp_path / "out")
    (tmp_path / "out" / SIDECAR).unlink()
    for split in ("train", "test"):
        path = tmp_path / "out" / f"transforms_{split}.json"
        content = json.loads(path.read_text())
        path.write_text(json.dumps({"camera_angle_x": content["camera_angle_x"], "frames": content["frames"]}))
    again = load_scene(tmp_path / "out")
    assert {v.name: v.split for v in again.views} == {f"{v.split}/{v.name}": v.split for v in scene.views}
    ours = {f"{v.split}/{v.name}": v for v in scene.views}
    for view in again.views:
        assert abs(view.camera.fx - 90) < EXACT and view.camera.is_centred
        assert sorted(view.truth) == (["alpha", "depth", "normals"] if ours[view.name].truth else [])
        if view.truth:
            assert np.abs(view.read_truth("normals") - ours[view.name].read_truth("normals")).max() < 2 / 255
            assert view.truth["depth"].name.endswith("_disp.tiff")
            assert (
                np.abs(view.read_truth("depth") - ours[view.name].read_truth("depth")).max() < 4e-5
            )  # steps of (1 + t)^2 / 65535


def test_llff_rows_follow_sorted_names_and_hold_out_without_sidecar(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    scene = make_scene(count=17)
    shuffled = scene.with_views(tuple(scene.views[i] for i in np.random.default_rng(0).permutation(17)))
    llff.save(shuffled, tmp_path / "out")
    rows = llff.read_rows(tmp_path / "out" / "poses_bounds.npy")
    assert rows.shape == (17, 17) and (rows[:, 15] > 0).all() and (rows[:, 16] > rows[:, 15]).all()
    (tmp_path / "out" / SIDECAR).unlink()
    again = load_scene(tmp_path / "out")
    same_rays(scene, again)
    assert [v.name for v in again.views if v.split == "test"] == ["000", "008", "016"]


def test_views_of_several_cameras_survive(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    scene = make_scene(truth=False)
    views = tuple(replace(v, camera=replace(v.camera, fx=90.0 + i, fy=90.0 + i)) for i, v in enumerate(scene.views))
    for layout, save in WRITERS.items():
        save(scene.with_views(views), tmp_path / layout)
        again = load_scene(tmp_path / layout)
        assert np.allclose([v.camera.fx for v in again.views], 90.0 + np.arange(9), atol=EXACT)


@pytest.mark.parametrize("layout", WRITERS)
def test_a_failed_export_leaves_nothing(make_scene: Callable[..., Scene], tmp_path: Path, layout: str) -> None:
    scene = make_scene(LENS)
    scene.views[5].image.write_bytes(scene.views[5].image.read_bytes()[:500])
    with pytest.raises(DatasetError, match=r"005\.png"):
        WRITERS[layout](scene, tmp_path / "here" / "out")
    assert list((tmp_path / "here").iterdir()) == []
    images.write(scene.views[5].image, np.zeros((72, 97, 3)))
    with pytest.raises(DatasetError, match="it is 97x72, its camera says 96x72"):
        WRITERS[layout](scene, tmp_path / "here" / "out")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "precious").write_text("x")
    with pytest.raises(UsageError, match="already exists"):
        WRITERS[layout](scene, tmp_path / "full")


def test_ctrl_c_leaves_nothing(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    def stop() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        blender.save(make_scene(), tmp_path / "here" / "out", done=stop)
    assert list((tmp_path / "here").iterdir()) == []
