"""Metashape's camera exports: lens, world and pictures as Metashape's manual has them, and a part of a real file."""

from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats import detect, load_scene, save_scene
from koala3d.datasets.formats.captures import metashape
from koala3d.datasets.imaging import images

WIDTH, HEIGHT = 160, 120
LENS = {"f": 150.0, "cx": 3.5, "cy": -2.25, "b1": 0.75, "k1": -0.11, "k2": 0.04, "k3": -0.01, "p1": 0.002, "p2": -0.0015}
ROTATION = pose.from_rotation_vector([0.3, -0.2, 0.9])[:3, :3]
SCALE, SHIFT = 0.25, np.array([1.0, -2.0, 0.5])


def numbers(values) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def export(
    folder: Path,
    *,
    lens: dict[str, float] = LENS,
    kind: str = "frame",
    world: str = "component",
    scaled: bool = True,
    bars: int = 0,
    labels: tuple[str, ...] = ("a", "b.JPG", r"C:\photos\day 1\c.jpg"),
    more: str = "",
) -> list[np.ndarray]:
    """Write an export with its images; returns the chunk_from_camera of each label."""
    poses = [pose.look_at((4 * np.cos(k), 4 * np.sin(k), 1.0 + k), (0, 0, 0)) for k in range(len(labels))]
    scale = f"<scale locked='true'>{SCALE}</scale>" if scaled else ""
    transform = (
        f"<transform><rotation>{numbers(ROTATION)}</rotation><translation>{numbers(SHIFT)}</translation>{scale}</transform>"
    )
    component = f"<components><component id='3'>{transform if world == 'component' else ''}</component></components>"
    cameras = "".join(
        f"<camera id='{k}' sensor_id='7' component_id='3' label={quoteattr(label)}><transform>{numbers(one)}</transform></camera>"
        for k, (label, one) in enumerate(zip(labels, poses, strict=True))
    )
    terms = "".join(f"<{name}>{value}</{name}>" for name, value in lens.items())
    size = f"<resolution width='{WIDTH}' height='{HEIGHT}'/>"
    sensor = (
        f"<sensor id='7' type='{kind}'>{size}<calibration type='{kind}' class='initial'>{size}<f>1</f></calibration>"
        f"<calibration type='{kind}' class='adjusted'>{size}{terms}</calibration></sensor>"
    )
    bar = "<scalebar id='0' label='one'><reference distance='0.2'/></scalebar>" * bars
    chunk = f"<sensors>{sensor}</sensors>{component}<cameras><group id='0'>{cameras}</group>{more}</cameras>"
    chunk += f"<scalebars>{bar}</scalebars>{transform if world == 'chunk' else ''}"
    (folder / "images").mkdir(parents=True)
    (folder / "cameras.xml").write_text(
        f"<?xml version='1.0'?><document version='2.0.0'><chunk label='1'>{chunk}</chunk></document>"
    )
    random = np.random.default_rng(0)
    for label in labels:
        name = label.replace("\\", "/").rpartition("/")[2].partition(".")[0]
        images.write(folder / "images" / f"{name}.jpg", random.integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8))
    return poses


def projected(lens: dict[str, float], points: np.ndarray) -> np.ndarray:
    """(n, 2) pixels of (n, 3) points in the camera's axes, by the formulas of the manual; the first pixel's centre is at 0.5."""
    of = {name: lens.get(name, 0.0) for name in ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2")}
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    r2 = x * x + y * y
    radial = 1 + of["k1"] * r2 + of["k2"] * r2**2 + of["k3"] * r2**3 + of["k4"] * r2**4
    bent_x = x * radial + of["p1"] * (r2 + 2 * x * x) + 2 * of["p2"] * x * y
    bent_y = y * radial + of["p2"] * (r2 + 2 * y * y) + 2 * of["p1"] * x * y
    u = WIDTH * 0.5 + of["cx"] + bent_x * of["f"] + bent_x * of["b1"] + bent_y * of["b2"]
    return np.stack([u, HEIGHT * 0.5 + of["cy"] + bent_y * of["f"]], axis=1)


@pytest.mark.parametrize("world", ["component", "chunk"])
def test_points_are_seen_where_metashape_sees_them(tmp_path, world) -> None:
    poses = export(tmp_path / "scan", world=world, bars=2)
    scene = load_scene(tmp_path / "scan")
    assert detect(tmp_path / "scan") == "metashape" and scene.metric
    assert [view.name for view in scene.views] == ["images/a", "images/b", "images/c"]
    assert "the unit is the metre by 2 scale bars" in scene.notes
    points = np.random.default_rng(1).uniform(-0.8, 0.8, (50, 3))
    for view, chunk_from_camera in zip(scene.views, poses, strict=True):
        in_chunk = (points - chunk_from_camera[:3, 3]) @ chunk_from_camera[:3, :3]
        in_world = SCALE * points @ ROTATION.T + SHIFT
        seen = (in_world - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
        assert np.allclose(view.camera.project(seen), projected(LENS, in_chunk), atol=1e-9)


def test_without_a_scale_the_unit_is_not_the_metre(tmp_path) -> None:
    export(tmp_path / "scan", scaled=False, bars=1)
    scene = load_scene(tmp_path / "scan")
    assert not scene.metric
    assert any("1 scale bars are there, so update the reference" in note for note in scene.notes)


def test_cameras_that_are_not_used_are_counted(tmp_path) -> None:
    more = "<camera id='8' sensor_id='7' label='a'/><camera id='9' sensor_id='7' label='b' enabled='false'><transform/></camera>"
    export(tmp_path / "scan", more=more, labels=("a", "b", "c", "d"))
    (tmp_path / "scan" / "images" / "d.jpg").unlink()
    scene = load_scene(tmp_path / "scan")
    assert len(scene.views) == 3
    said = " ".join(scene.notes)
    assert "1 cameras are not aligned" in said and "1 cameras are disabled" in said and "missing and left out: d" in said


def test_a_fourth_coefficient_needs_undistorted_pictures(tmp_path) -> None:
    lens = LENS | {"k4": 0.02}
    export(tmp_path / "scan", lens=lens)
    with pytest.raises(DatasetError, match=r"fourth radial coefficient.*--undistort"):
        load_scene(tmp_path / "scan")
    (view, *_) = load_scene(tmp_path / "scan", any_lens=True).views
    points = np.random.default_rng(2).uniform([-0.4, -0.3, 1], [0.4, 0.3, 1], (30, 3))
    assert np.allclose(view.camera.project(points), projected(lens, points), atol=1e-9)


def test_a_fisheye_is_equidistant(tmp_path) -> None:
    lens = {"f": 60.0, "cx": 1.0, "cy": 2.0, "k1": 0.03, "k2": -0.01, "k3": 0.002, "k4": -0.001}
    export(tmp_path / "scan", kind="fisheye", lens=lens)
    (view, *_) = load_scene(tmp_path / "scan").views
    for theta in (0.0, 0.3, 0.9):
        bent = theta * (1 + 0.03 * theta**2 - 0.01 * theta**4 + 0.002 * theta**6 - 0.001 * theta**8)
        seen = view.camera.project(np.array([[np.sin(theta) * 0.6, np.sin(theta) * 0.8, np.cos(theta)]]))
        assert np.allclose(seen, [[81 + 60 * bent * 0.6, 62 + 60 * bent * 0.8]], atol=1e-9)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"kind": "spherical"}, "lens model spherical is not supported"),
        ({"lens": LENS | {"b2": 2.0}}, "pixels are not rectangular"),
        ({"lens": LENS | {"p3": 0.1}}, "with p3 and p4 is not supported"),
        ({"kind": "fisheye"}, "a fisheye with p1 and p2 is not supported"),
        ({"more": "<camera id='8' sensor_id='1' label='a'><transform>1 2 3</transform></camera>"}, "sensor is not in the file"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path, options, words) -> None:
    export(tmp_path / "scan", **options)
    with pytest.raises(DatasetError, match=words):
        load_scene(tmp_path / "scan")


def test_entities_are_refused(tmp_path) -> None:
    export(tmp_path / "scan")
    path = tmp_path / "scan" / "cameras.xml"
    path.write_text(path.read_text().replace("<document", "<!DOCTYPE d [<!ENTITY a 'b'>]><document", 1))
    with pytest.raises(DatasetError, match="XML is not plain"):
        load_scene(tmp_path / "scan")


def test_it_becomes_a_scene_of_another_layout(tmp_path) -> None:
    export(tmp_path / "scan")
    scene = load_scene(tmp_path / "scan")
    save_scene(scene, tmp_path / "colmap", "colmap")
    again = load_scene(tmp_path / "colmap")
    for one, other in zip(scene.views, again.views, strict=True):
        assert np.allclose(one.world_from_camera, other.world_from_camera, atol=1e-12)
        assert one.camera.fx == pytest.approx(other.camera.fx) and one.camera.p1 == pytest.approx(other.camera.p1)


def test_a_geocentric_world_is_where_the_gps_was(tmp_path) -> None:
    """Numbers of a real survey (DJI M3M): the camera is where its own GPS reference says, and its world comes near the origin."""
    rotation = (
        "0.8710699454 0.3070967021 -0.3833128821 -0.4909742007 0.5658364395 -0.6623997719 0.0134716110 0.7651932691 0.6436596744"
    )
    placed = (
        "-0.99988146 -0.00872749 0.01268391 7.04224697 -0.00842932 0.99969124 0.02337453 7.05403071 "
        "-0.01288400 0.02326485 -0.99964631 0.43561421 0 0 0 1"
    )
    chunk = (
        "<sensors><sensor id='0' type='frame'><resolution width='5280' height='3956'/>"
        "<calibration class='adjusted'><f>3705.47</f></calibration></sensor></sensors><components><component id='0'><transform>"
        f"<rotation>{rotation}</rotation><translation>-2499366.429888 -4256836.520906 4029217.965003</translation>"
        "<scale>12.354192447331316</scale></transform></component></components>"
        f"<cameras><camera id='0' sensor_id='0' component_id='0' label='x'><transform>{placed}</transform></camera></cameras>"
    )
    folder = tmp_path / "survey"
    folder.mkdir()
    (folder / "survey.xml").write_text(f"<document version='2.0.0'><chunk>{chunk}</chunk></document>")
    images.write(folder / "x.png", np.zeros((989, 1320, 3), np.uint8))
    scene = load_scene(folder)
    (note,) = [note for note in scene.notes if "the world is moved by" in note]
    moved = np.array([float(word) for word in note.split("moved by ")[1].split(":")[0].split(", ")])
    geocentric = scene.views[0].world_from_camera[:3, 3] - moved
    longitude, latitude, height = np.deg2rad(-120.417985477), np.deg2rad(39.41191747), 2420.109
    square = 0.00669437999014  # of WGS84's eccentricity
    across = 6378137 / np.sqrt(1 - square * np.sin(latitude) ** 2)
    east = (across + height) * np.cos(latitude) * np.array([np.cos(longitude), np.sin(longitude)])
    truth = np.array([*east, (across * (1 - square) + height) * np.sin(latitude)])
    assert np.linalg.norm(geocentric - truth) < 10  # a drone's GPS; with a wrong order of the transform it would be thousands
    assert metashape.detect(folder)
