"""Lenses that our camera holds, and those of which an undistorted copy is made: against COLMAP's own projection."""

import json
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.cli import app
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats import colmap_library, load_scene, save_scene
from koala3d.datasets.scene import Scene
from tests.foreign import colmap as foreign

pycolmap = pytest.importorskip("pycolmap")

SIZE = (96, 72)
HELD = {
    "SIMPLE_PINHOLE": [90.0, 48.3, 35.2],
    "PINHOLE": [90.0, 91.0, 48.3, 35.2],
    "SIMPLE_RADIAL": [90.0, 48.3, 35.2, 0.1],
    "RADIAL": [90.0, 48.3, 35.2, -0.1, 0.05],
    "OPENCV": [90.0, 91.0, 48.3, 35.2, -0.1, 0.05, 1e-3, -2e-3],
    "OPENCV_FISHEYE": [90.0, 91.0, 48.3, 35.2, -0.1, 0.05, 0.01, -0.02],
    "FULL_OPENCV": [90.0, 91.0, 48.3, 35.2, -0.1, 0.05, 1e-3, -2e-3, 0.01, 0.02, -0.01, 0.005],
    "SIMPLE_RADIAL_FISHEYE": [90.0, 48.3, 35.2, 0.1],
    "RADIAL_FISHEYE": [90.0, 48.3, 35.2, 0.1, -0.05],
    "SIMPLE_FISHEYE": [90.0, 48.3, 35.2],
    "FISHEYE": [90.0, 91.0, 48.3, 35.2],
}
FOREIGN = {
    "FOV": [90.0, 91.0, 48.3, 35.2, 0.6],
    "THIN_PRISM_FISHEYE": [90.0, 91.0, 48.3, 35.2, 0.1, 0.02, 1e-3, -2e-3, 0.01, -0.01, 2e-3, -1e-3],
    "RAD_TAN_THIN_PRISM_FISHEYE": [90.0, 91.0, 48.3, 35.2, *[0.01] * 6, 1e-3, -2e-3, *[1e-3] * 4],
    "SIMPLE_DIVISION": [90.0, 48.3, 35.2, -0.1],
    "DIVISION": [90.0, 91.0, 48.3, 35.2, -0.1],
    "EUCM": [90.0, 91.0, 48.3, 35.2, 0.5, 1.1],
}


@pytest.fixture
def with_lens(make_scene: Callable[..., Scene], tmp_path: Path) -> Callable[..., Path]:
    """Factory of a COLMAP folder with the lens that is given, its pictures smooth in space: as that lens sees a wall."""

    def make(model: str, parameters: list[float]) -> Path:
        folder = tmp_path / "scene"
        save_scene(make_scene(Camera(*SIZE, 90.0, 90.0, 48.0, 36.0), truth=False, mask=True), folder, "colmap-text")
        (folder / "koala.json").unlink()
        stored = pycolmap.Reconstruction(folder / "sparse" / "0")
        stored.camera(1).model = pycolmap.CameraModelId.__members__[model]
        stored.camera(1).params = parameters
        stored.write_text(folder / "sparse" / "0")
        return folder

    return make


@pytest.mark.parametrize("text", [False, True])
def test_our_camera_projects_as_colmap_does(tmp_path: Path, text: bool) -> None:
    """In a model with one camera of each lens; at the corners of the pictures too."""
    made = foreign.model(HELD, foreign.ring(len(HELD)), SIZE)
    foreign.write(made, tmp_path, text=text)
    views = {view.image.name: view for view in load_scene(tmp_path, hold_out=0).views}
    assert len(views) == len(HELD)
    for image in made.images.values():
        camera = views[image.name].camera
        rays = camera.directions(camera.pixel_centres()[::7, ::7].reshape(-1, 2))
        assert np.abs(image.camera.img_from_cam(rays) - camera.project(rays)).max() < 1e-9, image.camera.model


@pytest.mark.parametrize("model", FOREIGN)
def test_a_foreign_lens_is_refused_with_the_command_that_mends_it(
    with_lens: Callable[..., Path], tmp_path: Path, model: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = with_lens(model, FOREIGN[model])
    with pytest.raises(DatasetError, match=f"camera model {model} is not supported") as refused:
        load_scene(folder)
    monkeypatch.chdir(tmp_path)
    program, *words = shlex.split(str(refused.value).split(": ")[-1])
    assert program == "datasets" and CliRunner().invoke(app, words).exit_code == 0
    scene = load_scene(tmp_path / "scene_undistorted")
    assert len(scene.views) == 9 and all(view.camera.is_centred and view.read().shape[-1] == 4 for view in scene.views)
    theirs = pycolmap.Camera(camera_id=1, model=model, width=SIZE[0], height=SIZE[1], params=FOREIGN[model])
    old = load_scene(folder, any_lens=True).views[3]
    new = next(view for view in scene.views if view.name == old.name)
    pixels = new.camera.pixel_centres()[10:-10:9, 10:-10:9].reshape(-1, 2)
    rays = new.camera.directions(pixels) @ new.world_from_camera[:3, :3].T @ old.world_from_camera[:3, :3]
    seen = theirs.img_from_cam(rays)
    column, row = np.floor(seen).astype(int).T
    picture, straight = old.read(), new.read()
    x, y = np.floor(pixels).astype(int).T
    neighbours = [picture[row + dr, column + dc, :3] for dr in (-1, 0, 1) for dc in (-1, 0, 1)]
    slack = 0.1  # a quintic spline overshoots its nodes a little
    colours = straight[y, x, :3]
    assert (colours >= np.min(neighbours, 0) - slack).all() and (colours <= np.max(neighbours, 0) + slack).all()
    within = np.hypot(*(seen - [48.0, 36.0]).T)
    assert (straight[y, x, 3][within < 18] == 1).all() and (straight[y, x, 3][within > 22] == 0).all()  # the disc of the mask


@pytest.mark.parametrize("model", FOREIGN)
def test_a_foreign_lens_is_inverted_by_the_library(model: str) -> None:
    camera = colmap_library.camera(model, SIZE, tuple(FOREIGN[model]), where="a test")
    theirs = pycolmap.Camera(camera_id=1, model=model, width=SIZE[0], height=SIZE[1], params=FOREIGN[model])
    rays = camera.directions(camera.pixel_centres()[::7, ::7])
    assert np.abs(camera.project(rays) - camera.pixel_centres()[::7, ::7]).max() < 1e-6
    assert np.abs(theirs.img_from_cam(rays.reshape(-1, 3)) - camera.project(rays).reshape(-1, 2)).max() < 1e-9


def test_a_panorama_is_refused(with_lens: Callable[..., Path]) -> None:
    with pytest.raises(DatasetError, match="EQUIRECTANGULAR is not supported; cut perspective images from it"):
        load_scene(with_lens("EQUIRECTANGULAR", [96.0, 72.0]))


def test_an_unknown_lens_is_refused(with_lens: Callable[..., Path]) -> None:
    folder = with_lens("PINHOLE", [90.0, 90.0, 48.0, 36.0])
    cameras = folder / "sparse" / "0" / "cameras.txt"
    cameras.write_text(cameras.read_text().replace(" PINHOLE ", " PLENOPTIC "))
    with pytest.raises(DatasetError, match="lens model PLENOPTIC with 4 parameters is unknown"):
        load_scene(folder)


def k4_scene(folder: Path, scene: Scene, **content: object) -> Path:
    save_scene(scene, folder, "nerfstudio")
    (folder / "koala.json").unlink()
    stated = json.loads((folder / "transforms.json").read_text())
    (folder / "transforms.json").write_text(json.dumps({**stated, **content}))
    return folder


def test_k4_is_rational_only_where_the_file_says_so(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    """OpenCV's k4 stands below the line with k5 and k6; nerfstudio's is the fourth coefficient above it."""
    scene = make_scene(Camera(*SIZE, 90.0, 90.0, 48.0, 36.0), truth=False)
    lens = {"k1": -0.1, "k2": 0.02, "k3": 0.01, "k4": 0.05}
    for number, more in enumerate(({"k5": 0.01}, {"camera_model": "FULL_OPENCV"})):
        camera = load_scene(k4_scene(tmp_path / f"{number}", scene, **lens, **more)).views[0].camera
        assert (camera.k1, camera.k3, camera.k4, camera.k5) == (-0.1, 0.01, 0.05, more.get("k5", 0.0))
    folder = k4_scene(tmp_path / "polynomial", scene, **lens)
    with pytest.raises(DatasetError, match=r"k4 = 0\.05 as the fourth radial coefficient.*datasets edit .* --undistort"):
        load_scene(folder)
    camera = load_scene(folder, any_lens=True).views[0].camera
    x, y = 0.5, 0.3
    r2 = x * x + y * y
    factor = 1 - 0.1 * r2 + 0.02 * r2**2 + 0.01 * r2**3 + 0.05 * r2**4
    assert np.abs(camera.distort([x, y]) - np.array([x, y]) * factor).max() < 1e-15
    assert np.abs(camera.undistort(camera.distort([x, y])) - [x, y]).max() < 1e-12
    done = CliRunner().invoke(app, ["edit", str(folder), "--undistort", "--out", str(tmp_path / "straight")])
    assert done.exit_code == 0 and load_scene(tmp_path / "straight").views[0].camera.is_centred


def test_the_command_quotes_its_paths(with_lens: Callable[..., Path]) -> None:
    folder = with_lens("FOV", FOREIGN["FOV"])
    folder.rename(folder.parent / "my scene")
    with pytest.raises(DatasetError, match=r"datasets edit '.*/my scene' --undistort --out 'my scene_undistorted'"):
        load_scene(folder.parent / "my scene")
