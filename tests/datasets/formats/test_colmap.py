"""COLMAP models against COLMAP itself."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats import colmap, detect, koala, llff, load_scene, save_scene
from koala3d.datasets.formats.colmap_files import read_model
from koala3d.datasets.formats.finding import models
from koala3d.datasets.scene import Scene
from tests.foreign import colmap as foreign
from tests.foreign import photographs

pycolmap = pytest.importorskip("pycolmap")

LENSES = {
    "SIMPLE_PINHOLE": [110.0, 60.3, 39.2],
    "SIMPLE_RADIAL": [110.0, 60.3, 39.2, 0.1],
    "OPENCV": [110.0, 112.0, 60.3, 39.2, -0.1, 0.05, 1e-3, -2e-3],
    "OPENCV_FISHEYE": [110.0, 112.0, 60.3, 39.2, -0.1, 0.05, 0.01, -0.02],
}
"""Of pictures of 120x80."""


def files_of(folder: Path) -> list[Path]:
    suffix = ".bin" if (folder / "cameras.bin").is_file() else ".txt"
    return [folder / (name + suffix) for name in (*models.NEEDED, models.POINTS)]


def errors_px(model: "pycolmap.Reconstruction") -> np.ndarray:
    """Reprojection error of every observation, by COLMAP's own projection."""
    found = []
    for image in model.images.values():
        for feature in image.points2D:
            if feature.has_point3D():
                found.append(np.linalg.norm(image.project_point(model.points3D[feature.point3D_id].xyz) - feature.xy))
    return np.array(found)


def test_reprojection_stays_through_koala_and_back(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    """The set's stated mean over 5,931 observations is 0.30 px."""
    source = real_data("colmap_small") / "dense"
    before = errors_px(pycolmap.Reconstruction(source / "sparse"))
    koala.save(load_scene(source), tmp_path / "koala")
    said = colmap.save(load_scene(tmp_path / "koala"), tmp_path / "colmap")
    after = errors_px(pycolmap.Reconstruction(tmp_path / "colmap" / "sparse" / "0"))
    assert len(before) == len(after) == 5931 and before.mean() == pytest.approx(0.30, abs=0.005)
    assert np.abs(np.sort(before) - np.sort(after)).max() < 1e-6
    assert "lens" not in said
    points = load_scene(tmp_path / "colmap").points
    assert points is not None and len(points) == 1443


@pytest.mark.parametrize("text", [False, True])
def test_pycolmap_opens_what_is_written(make_scene: Callable[..., Scene], tmp_path: Path, text: bool) -> None:
    scene = make_scene(Camera(96, 72, 90.0, 91.0, 50.3, 34.1, k1=-0.12, k2=0.05, p1=1e-3, p2=-8e-4, k3=0.01))
    colmap.save(scene, tmp_path / "out", text=text)
    model = pycolmap.Reconstruction(tmp_path / "out" / "sparse" / "0")
    assert model.num_images() == 9 and model.num_cameras() == 1 and model.is_valid()
    by_name = {view.name: view for view in scene.views}
    point = np.array([0.01, -0.02, 0.03])
    for image in model.images.values():
        view = by_name[Path(image.name).stem]
        expected = view.camera.project((point - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3])
        assert np.abs(image.project_point(point) - expected).max() < 1e-9
        assert (tmp_path / "out" / "images" / image.name).is_file()


@pytest.mark.parametrize("text", [False, True])
def test_a_model_of_colmaps_own_writer_is_read_as_colmap_has_it(tmp_path: Path, text: bool) -> None:
    """Several lenses in one model; where its images look, what they see where, and which pixels they are."""
    made = foreign.model(LENSES, foreign.ring(2 * len(LENSES)))
    foreign.write(made, tmp_path, text=text)
    assert detect(tmp_path) == "colmap"
    scene = load_scene(tmp_path, hold_out=0)
    views = {view.image.name: view for view in scene.views}
    assert len(views) == len(scene.views) == made.num_images() and scene.points is not None and scene.sightings is not None
    rows = np.linalg.norm(scene.points[:, None] - foreign.POINTS, axis=-1).argmin(1)
    assert np.array_equal(np.sort(rows), np.arange(len(foreign.POINTS))) and np.array_equal(scene.points, foreign.POINTS[rows])
    assert scene.colours is not None and np.array_equal(scene.colours[:, 0], rows)
    for image in made.images.values():
        view = views[image.name]
        towards = view.world_from_camera[:3, 2]
        np.testing.assert_allclose(view.world_from_camera[:3, 3], image.projection_center(), atol=1e-12)
        np.testing.assert_allclose(towards, image.viewing_direction(), atol=1e-12)
        local = (scene.points - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
        np.testing.assert_allclose(view.camera.project(local), [image.project_point(p) for p in scene.points], atol=1e-9)
        seen = scene.sightings.index[:, 1] == scene.sightings.names.index(view.name)
        theirs = [image.project_point(scene.points[point]) for point in scene.sightings.index[seen, 0]]
        assert seen.sum() == len(foreign.POINTS)
        np.testing.assert_allclose(scene.sightings.pixels[seen], theirs, atol=1e-9)
        assert np.abs(255 * view.read() - photographs.shown(view.image)).max() < 2.01  # steps by which decoders may differ


@pytest.mark.parametrize("text", [False, True])
def test_our_reader_agrees_with_pycolmap_on_rigs(tmp_path: Path, text: bool) -> None:
    """Two rigs of two cameras: the 4.x layout, where poses follow from rigs and frames."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig, options.num_points3D = 2, 2, 3, 40
    made = pycolmap.synthesize_dataset(options)
    (made.write_text if text else made.write_binary)(tmp_path)
    assert any(path.stem == "rigs" for path in tmp_path.iterdir())  # the premise
    model = read_model(*files_of(tmp_path))
    ours = {image.name: image for image in model.images}
    assert len(ours) == 12
    for image in made.images.values():
        mine = ours[image.name]
        assert np.abs(mine.camera_from_world[:3] - image.cam_from_world().matrix()).max() < 1e-12
        assert model.cameras[mine.camera_id].model == image.camera.model.name
        assert np.allclose(model.cameras[mine.camera_id].parameters, image.camera.params)
        seen = [(f.xy, made.points3D[f.point3D_id].xyz) for f in image.points2D if f.has_point3D()]
        assert np.allclose(mine.pixels[mine.points >= 0], [xy for xy, _ in seen])
        assert np.allclose(model.points[mine.points[mine.points >= 0]], [xyz for _, xyz in seen])


@pytest.mark.parametrize(("name", "at", "value", "words"), [
    ("cameras", 0, 2**40, "promises more cameras than it holds"),
    ("images", 0, 2**63, "promises more images than it holds"),
    ("points3D", 0, 2**62, "promises more points than it holds"),
    ("points3D", 51, 2**61, "promises more sightings than it holds"),
])  # fmt: skip
def test_huge_counts_are_refused_before_allocation(
    make_scene: Callable[..., Scene], tmp_path: Path, name: str, at: int, value: int, words: str
) -> None:
    from dataclasses import replace

    scene = replace(make_scene(), points=np.random.default_rng(0).normal(size=(50, 3)))
    colmap.save(scene, tmp_path / "out")
    path = tmp_path / "out" / "sparse" / "0" / f"{name}.bin"
    data = path.read_bytes()
    path.write_bytes(data[:at] + value.to_bytes(8, "little") + data[at + 8 :])
    with pytest.raises(DatasetError, match=words):
        load_scene(tmp_path / "out")


def test_a_model_is_preferred_to_poses_bounds(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    """mip-NeRF 360's folders have both; without the images that it names, a model is of no use."""
    lens = Camera(96, 72, 90.0, 91.0, 50.3, 34.1, k1=-0.12)
    save_scene(make_scene(lens, truth=False), tmp_path / "out", "mipnerf360")
    (tmp_path / "out" / "koala.json").unlink()
    rows = [llff.row_of(np.eye(4), Camera(96, 72, 90.0, 90.0, 48.0, 36.0), 0.1, 1.0)] * 9
    np.save(tmp_path / "out" / "poses_bounds.npy", np.stack(rows))
    scene = load_scene(tmp_path / "out", images="images_4")
    assert scene.views[0].camera == lens.scaled(24, 18) and any("poses_bounds.npy is not used" in note for note in scene.notes)
    assert load_scene(tmp_path / "out", format="llff").views[0].camera.is_centred
    for path in sorted((tmp_path / "out").glob("images*/*")):
        path.rename(path.with_name(f"other{path.name}"))
    assert detect(tmp_path / "out") == "llff"


def test_masks_of_colmaps_naming(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    colmap.save(make_scene(mask=True), tmp_path / "out")
    assert (tmp_path / "out" / "masks" / "000.png.png").is_file()
    (tmp_path / "out" / "koala.json").unlink()
    scene = load_scene(tmp_path / "out")
    assert scene.background == "white" and scene.views[0].read().shape[-1] == 4
    assert [view.name for view in scene.split("test")] == ["000", "008"]
