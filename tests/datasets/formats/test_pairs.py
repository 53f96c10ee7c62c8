"""From one format to another and back: nothing is lost that both can hold."""

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.formats import WRITERS, load_scene, save_scene
from koala3d.datasets.formats.blender import LAYOUT as BLENDER
from koala3d.datasets.formats.dtu import LAYOUT as DTU
from koala3d.datasets.formats.llff import LAYOUT as LLFF
from koala3d.datasets.formats.nerfstudio import LAYOUT as NERFSTUDIO
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, Sightings, View

HOLDS: dict[str, Callable[[Camera], bool]] = {name: lambda camera: True for name in WRITERS}
HOLDS |= {"nerfstudio": NERFSTUDIO.holds, "blender": BLENDER.holds, "llff": LLFF.holds, "dtu": DTU.holds}
READ_AS = {name: name.replace("-text", "").replace("mipnerf360", "colmap") for name in WRITERS}
RELATIVE = 1e-6
"""Tolerance of poses and intrinsics; double precision keeps 1e-12."""
RAY_PX = 1e-4

_offset = st.floats(-2.0, 2.0)
_small = st.floats(-0.05, 0.05)


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    """A centred pinhole, an off-centre one with pixels that are not square, or a lens of one of three kinds."""
    kind = draw(st.sampled_from(("centred", "pinhole", "lens", "rational", "fisheye")))
    width, height, focal = draw(st.integers(16, 28)), draw(st.integers(16, 28)), draw(st.floats(15.0, 60.0))
    camera = Camera(width, height, focal, focal, width / 2, height / 2)
    if kind == "centred":
        return camera
    camera = replace(camera, fy=focal * draw(st.floats(0.9, 1.1)), cx=camera.cx + draw(_offset), cy=camera.cy + draw(_offset))
    if kind == "pinhole":
        return camera
    if kind == "fisheye":
        return replace(camera, fisheye=True, **{key: draw(_small) / 5 for key in ("k1", "k2", "k3", "k4")})
    terms = {key: draw(_small) for key in ("k1", "k2")} | {key: draw(_small) / 20 for key in ("p1", "p2")}
    higher = {key: draw(_small) / 5 for key in ("k4", "k5", "k6")} if kind == "rational" else {}
    return replace(camera, **terms, **higher, k3=draw(st.sampled_from((0.0, 0.01))))


@st.composite
def scenes(draw: st.DrawFn) -> Callable[[Path], Scene]:
    """What makes a random scene in a folder: poses anywhere, one camera or several, 8 or 16 bits, with or without masks."""
    shared = draw(st.booleans())
    common, own = draw(cameras()), [draw(cameras()) for _ in range(4)]
    seed, deep, masked = draw(st.integers(0, 2**32 - 1)), draw(st.booleans()), draw(st.booleans())
    size = draw(st.sampled_from((1e-2, 1.0, 1e3)))
    with_points = draw(st.booleans())

    def make(folder: Path) -> Scene:
        random = np.random.default_rng(seed)
        views = []
        for index in range(4):
            camera = common if shared else own[index]
            shape = (camera.height, camera.width)
            matrix = pose.look_at(size * random.normal(size=3) * [1, 1, 0.2] + [0, 0, size], random.normal(size=3) * size / 10)
            kind = np.uint16 if deep else np.uint8
            image, mask = folder / f"{index}.png", folder / f"{index}_mask.png"
            images.write(image, random.integers(0, np.iinfo(kind).max, (*shape, 3), kind, endpoint=True))
            if masked:
                images.write(mask, np.uint8(255 * (random.random(shape) > 0.3)))
            name = f"{'deep/' if index else ''}view {index}.x"
            split = ("train", "train", "val", "test")[index]
            views.append(View(name, camera, matrix, split, image, mask if masked else None))
        background = "white" if masked else "scene"
        scene = Scene("random", tuple(views), 0.1 * size, np.inf, size * np.array([[-1.0, -1, -1], [1, 1, 1]]), background)
        return _with_points(scene, random) if with_points else scene

    return make


def _with_points(scene: Scene, random: np.random.Generator) -> Scene:
    index = np.stack([random.permutation(np.repeat(np.arange(5), 2)), np.repeat(np.arange(2), 5)], axis=1)
    index = np.unique(index, axis=0)
    seen = Sightings(tuple(view.name for view in scene.views), index, random.uniform(0, 16, (len(index), 2)))
    colours = random.integers(0, 255, (5, 3), np.uint8)
    return replace(scene, points=random.normal(size=(5, 3)), colours=colours, sightings=seen)


def through(scene: Scene, layout: str, folder: Path) -> Scene:
    """The scene as it is read again after an export."""
    save_scene(scene, folder, layout)
    return load_scene(folder, format=READ_AS[layout])


def assert_same(one: Scene, other: Scene) -> None:
    """Poses, intrinsics, names, splits and pixels; the same pixel looks along the same ray."""
    assert [(v.name, v.split) for v in one.views] == [(v.name, v.split) for v in other.views]
    assert (one.near, one.far, one.background) == (other.near, other.far, other.background) and np.array_equal(one.box, other.box)
    for a, b in zip(one.views, other.views, strict=True):
        scale = np.abs(a.world_from_camera[:3, 3]).max()
        assert np.abs(a.world_from_camera[:3, :3] - b.world_from_camera[:3, :3]).max() < RELATIVE
        assert np.abs(a.world_from_camera[:3, 3] - b.world_from_camera[:3, 3]).max() < RELATIVE * scale
        assert (a.camera.width, a.camera.height) == (b.camera.width, b.camera.height)
        numbers = [np.array(list(camera.to_json().values())) for camera in (a.camera, b.camera)]
        assert (np.abs(numbers[0] - numbers[1]) <= RELATIVE * np.maximum(np.abs(numbers[0]), 1e-3)).all()
        pixels = a.camera.pixel_centres()[::3, ::3]
        exists = (
            np.abs(a.camera.project(a.camera.directions(pixels)) - pixels).max(-1) < 1e-6
        )  # a lens may end before its picture
        assert exists.mean() > 0.5
        pixels = pixels[exists]
        rays = b.camera.directions(pixels) @ (b.world_from_camera[:3, :3].T @ a.world_from_camera[:3, :3])
        assert np.abs(a.camera.project(rays) - pixels).max() < RAY_PX
        one_picture, other_picture = a.read(), b.read()
        assert np.array_equal(one_picture[..., :3], other_picture[..., :3])
        assert np.abs(one_picture - other_picture).max() < 1e-7  # an alpha of n / 255 as 257 n / 65535, each rounded to float32


PAIRS = [("koala", name) for name in WRITERS] + [("blender", "llff"), ("colmap-text", "nerfstudio"), ("mipnerf360", "dtu")]
"""Every writer and reader with our own format, which holds everything, and three mixed pairs."""


@pytest.mark.parametrize(("first", "second"), PAIRS)
@settings(max_examples=3, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(make=scenes())
def test_there_and_back(first: str, second: str, make: Callable[[Path], Scene]) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        here = through(make(folder / "source"), first, folder / "here")
        there = through(here, second, folder / "there")
        back = through(there, first, folder / "back")
        if all(HOLDS[second](view.camera) for view in here.views):
            assert_same(here, there)
            assert_same(here, back)
        assert_same(there, back)  # after resampling to centred pinholes, every format holds it


def assert_same_sightings(one: Scene, other: Scene) -> None:
    """Points and who saw them where, in whatever order."""
    assert one.points is not None and other.points is not None and one.sightings is not None and other.sightings is not None

    def rows(scene: Scene) -> Any:
        seen = scene.sightings
        named = [
            (seen.names[view], *scene.points[point].tolist(), *pixel, *scene.colours[point].tolist())
            for (point, view), pixel in zip(seen.index, seen.pixels.tolist(), strict=True)
        ]
        return sorted(named)

    assert [row[0] for row in rows(one)] == [row[0] for row in rows(other)]
    assert np.allclose([row[1:] for row in rows(one)], [row[1:] for row in rows(other)], rtol=RELATIVE, atol=1e-9)


@pytest.mark.parametrize("layout", ["koala", "colmap", "colmap-text", "mipnerf360"])
@settings(max_examples=5, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(make=scenes())
def test_points_and_sightings_survive(layout: str, make: Callable[[Path], Scene]) -> None:
    with tempfile.TemporaryDirectory() as name:
        scene = make(Path(name) / "source")
        if scene.points is None:
            scene = _with_points(scene, np.random.default_rng(0))
        assert_same_sightings(scene, through(scene, layout, Path(name) / "there"))


def test_a_writer_says_what_it_cannot_hold(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="did you mean 'colmap'"):
        save_scene(make_scene(), tmp_path / "x", "colmapp")
    with pytest.raises(UsageError, match="dtu cannot hold smaller images"):
        save_scene(make_scene(), tmp_path / "x", "dtu", sizes=(2,))
    lens = Camera(96, 72, 90.0, 91.0, 50.3, 34.1, k1=-0.12)
    said = save_scene(make_scene(lens, mask=True), tmp_path / "b", "blender")
    assert "lens distortion or an off-centre principal point: 9 views were resampled" in said and "9 were put into" in said


@pytest.mark.parametrize("layout", ["koala", "nerfstudio", "llff", "colmap", "mipnerf360"])
def test_smaller_images_are_found_and_fit(make_scene: Callable[..., Scene], tmp_path: Path, layout: str) -> None:
    scene = make_scene(Camera(96, 72, 90.0, 90.0, 48.0, 36.0), mask=layout == "koala")
    save_scene(scene, tmp_path / "out", layout, sizes=() if layout == "mipnerf360" else (2, 4, 8))
    for factor in (2, 4, 8):
        small = load_scene(tmp_path / "out", format=READ_AS[layout], images=f"images_{factor}")
        view = small.views[0]
        assert view.camera == Camera(96 // factor, 72 // factor, 90 / factor, 90 / factor, 48 / factor, 36 / factor)
        expected = images.resize(scene.views[0].read_image(), 96 // factor, 72 // factor)
        assert np.abs(view.read()[..., :3] - expected).max() < 0.51 / 255  # rounding to 8 bits
        assert view.name == scene.views[0].name and view.truth == {}
