"""The size of a model: by markers, by a known length, by positions of cameras or of an arm's flange."""

from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.process.pictures import markers
from koala3d.datasets.process.pictures.markers import Marker
from koala3d.datasets.process.world import scale
from koala3d.datasets.process.world.similarity import Similarity, upwards
from koala3d.datasets.scene import View

CAMERA = Camera(1000, 800, 900, 905, 505, 395, k1=-0.03)
WORLD_FROM_MODEL = Similarity(0.4, upwards([0.3, -0.2, 0.7]), np.array([0.2, -0.1, 0.5]))
SIDE = 0.05
SQUARE = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * SIDE / 2 + [0.1, 0.05, 0.0]


@pytest.fixture
def views() -> list[View]:
    """Twelve cameras around the origin, in a frame and unit of their own."""
    result, random = [], np.random.default_rng(0)
    model_from_world = Similarity(
        1 / WORLD_FROM_MODEL.scale,
        WORLD_FROM_MODEL.rotation.T,
        -WORLD_FROM_MODEL.rotation.T @ WORLD_FROM_MODEL.translation / WORLD_FROM_MODEL.scale,
    )
    for k in range(12):
        place = [0.5 * np.cos(k / 2), 0.5 * np.sin(k / 2), 0.3 + 0.1 * (k % 3)]
        matrix = pose.look_at(place, random.normal(scale=0.02, size=3)) @ pose.from_rotation_vector([0, 0, 0.3 * (k % 4)])
        result.append(model_from_world.view(View(f"IMG_{k}", CAMERA, matrix, "train", Path(f"IMG_{k}.jpg"))))
    return result


def seen(view: View, points: np.ndarray) -> np.ndarray:
    """Pixels of (n, 3) points of the world."""
    in_world = WORLD_FROM_MODEL.view(view).world_from_camera
    return CAMERA.project((points - in_world[:3, 3]) @ in_world[:3, :3])


def test_a_marker_is_placed_and_gives_the_scale(views: list[View]) -> None:
    random = np.random.default_rng(1)
    found = markers.place(
        views, {v.name: [Marker("4X4_1000 3", seen(v, SQUARE) + random.normal(scale=0.2, size=(4, 2)))] for v in views}
    )
    assert [marker.seen for marker in found] == [12]
    factor, words = scale.by_markers(found, SIDE)
    assert factor == pytest.approx(WORLD_FROM_MODEL.scale, rel=0.003)  # 0.2 px of noise on a side of 75 px in 12 views
    assert "4X4_1000 3 in 12 pictures" in words
    np.testing.assert_allclose(WORLD_FROM_MODEL.rotation @ found[0].normal, [0, 0, 1], atol=0.02)


def test_a_wrong_sighting_is_left_out_and_no_square_is_no_marker(views: list[View]) -> None:
    sightings = {view.name: [Marker("a 1", seen(view, SQUARE))] for view in views}
    sightings[views[3].name] = [Marker("a 1", seen(views[3], SQUARE) + 40)]
    assert [marker.seen for marker in markers.place(views, sightings)] == [11]
    long = SQUARE * [1.2, 1, 1]
    assert not markers.place(views, {view.name: [Marker("a 1", seen(view, long))] for view in views})
    assert not markers.place(views[:2], {view.name: [Marker("a 1", seen(view, SQUARE))] for view in views})
    twice = {view.name: [Marker("a 1", seen(view, SQUARE))] * 2 for view in views}
    assert not markers.place(views, twice)


def test_no_marker_is_said(views: list[View]) -> None:
    with pytest.raises(UsageError, match="no printed marker was found"):
        scale.by_markers([], 0.04)


def words(views: list[View], point: np.ndarray) -> str:
    return "+".join(f"{v.name}:{x:.2f},{y:.2f}" for v in views for x, y in [seen(v, point)])


def test_a_known_length_gives_the_scale(views: list[View]) -> None:
    ends = np.array([[0.1, 0.0, 0.02], [-0.08, 0.05, 0.0]])
    length = float(np.linalg.norm(ends[0] - ends[1]))
    known = scale.KnownLength.parse(words([views[0], views[4]], ends[0]), words(views[2:5], ends[1]), length)
    factor, evidence = scale.by_length(views, known)
    assert factor == pytest.approx(WORLD_FROM_MODEL.scale, rel=1e-3)  # pixels are written with two digits
    assert "known length of 0.1878" in evidence


@pytest.mark.parametrize(
    ("first", "length", "complaint"),
    [
        ("IMG_0:1,2", 1.0, "does not name a point"),
        ("IMG_0:1,2+IMG_0:3,4", 1.0, "does not name a point"),
        ("IMG_0:1,2+IMG_1:3", 1.0, "does not name a point"),
        ("IMG_0:a,2+IMG_1:3,4", 1.0, "does not name a point"),
        ("IMG_0:1,2+IMG_1:3,4", 0.0, "must be positive"),
        ("IMG_0:1,2+IMG_1:3,4", float("nan"), "must be positive"),
    ],
)
def test_an_impossible_length_is_refused(first: str, length: float, complaint: str) -> None:
    with pytest.raises(UsageError, match=complaint):
        scale.KnownLength.parse(first, "IMG_0:1,2+IMG_1:3,4", length)


def test_a_length_in_unknown_pictures_is_refused(views: list[View]) -> None:
    known = scale.KnownLength.parse("IMG_0:1,2+img_1:3,4", "IMG_0:1,2+IMG_1:3,4", 1.0)
    with pytest.raises(UsageError, match="no picture called 'img_1' was placed; valid: IMG_0, IMG_1,"):
        scale.by_length(views, known)


def flange(views: list[View], offset: np.ndarray, noise_m: float = 0.0) -> dict[str, np.ndarray]:
    random, found = np.random.default_rng(2), {}
    for view in views:
        in_world = WORLD_FROM_MODEL.view(view).world_from_camera
        found[view.name] = in_world[:3, 3] + in_world[:3, :3] @ offset + random.normal(scale=noise_m, size=3)
    return found


@pytest.mark.parametrize("offset", [(0, 0, 0), (0.02, -0.05, -0.08)])
def test_positions_give_the_world(views: list[View], offset: tuple) -> None:
    found, evidence = scale.by_positions(views, flange(views, np.array(offset), 1e-4))
    assert found.scale == pytest.approx(WORLD_FROM_MODEL.scale, rel=1e-3)
    for view in views:
        a, b = found.view(view).world_from_camera, WORLD_FROM_MODEL.view(view).world_from_camera
        assert np.linalg.norm(a[:3, 3] - b[:3, 3]) < 1e-3
    assert ("mm beside the camera" in evidence) == any(offset)


def test_positions_that_do_not_fit_are_refused(views: list[View]) -> None:
    positions = flange(views, np.zeros(3))
    with pytest.raises(UsageError, match=r"too few pictures have a position.*3 of 12"):
        scale.by_positions(views, dict(list(positions.items())[:3]))
    mixed = dict(zip(positions, [*list(positions.values())[5:], *list(positions.values())[:5]], strict=True))
    with pytest.raises(UsageError, match="positions do not fit the pictures"):
        scale.by_positions(views, mixed)


def test_a_file_of_positions(tmp_path: Path) -> None:
    path = tmp_path / "arm.txt"
    path.write_text("# name x y z\nIMG 0.jpg 0.1 0.2 0.3\n\nIMG_1, 1e-1, -2, 3\n")
    found = scale.read_positions(path)
    assert {name: list(place) for name, place in found.items()} == {"IMG 0.jpg": [0.1, 0.2, 0.3], "IMG_1": [0.1, -2, 3]}
    for line, complaint in (("a 1 2", "is not a name"), ("a 1 2 nan", "is not a name"), ("IMG_1 1 2 3", "listed twice")):
        path.write_text(f"IMG_1 0 0 0\n{line}\n")
        with pytest.raises(DatasetError, match=f"arm.txt, line 2: .*{complaint}"):
            scale.read_positions(path)
    with pytest.raises(UsageError, match="no such file"):
        scale.read_positions(tmp_path / "none.txt")


def test_pictures_are_found_by_file_name_too(views: list[View]) -> None:
    positions = {f"{name}.jpg": place for name, place in flange(views, np.zeros(3)).items()}
    assert scale.by_positions(views, positions)[0].scale == pytest.approx(WORLD_FROM_MODEL.scale)


@pytest.mark.parametrize(
    "line", ["a 1;0,5;-1,25;2", "a 1\t0,5\t-1,25\t2,0", "a1 0,5 -1,25 2,0", "a 1, 0.5, -1.25, 2", "a1,0.5,-1.25,2"]
)
def test_positions_as_spreadsheets_write_them(tmp_path: Path, line: str) -> None:
    """Decimal commas of a European Excel, with a byte order mark; and commas between."""
    (tmp_path / "positions.csv").write_bytes(b"\xef\xbb\xbf" + line.encode() + b"\r\n")
    (position,) = scale.read_positions(tmp_path / "positions.csv").values()
    assert position.tolist() == [0.5, -1.25, 2.0]
