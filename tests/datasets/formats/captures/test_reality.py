"""RealityScan's camera exports: the conventions that other importers of them share, a real row, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.formats import detect, load_scene
from koala3d.datasets.imaging import images

HEADER = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2"
WIDTH, HEIGHT = 160, 120


def export(folder: Path, rows: list[str], header: str = HEADER, size: tuple[int, int] = (WIDTH, HEIGHT)) -> Path:
    """Write a CSV and the images of its rows."""
    (folder / "images").mkdir(parents=True)
    (folder / "cameras.csv").write_text("\n".join([header, *rows]) + "\n")
    for k, row in enumerate(rows):
        picture = np.full((size[1], size[0], 3), 40 * k + 10, np.uint8)
        images.write(folder / "images" / row.split(",")[0], picture)
    return folder


def row(name: str, x, y, alt, heading, pitch, roll, f=20.0, *lens: float) -> str:
    return ",".join([name, *(repr(float(value)) for value in (x, y, alt, heading, pitch, roll, f, *(lens or [0.0] * 8)))])


def test_cameras_look_where_heading_pitch_and_roll_say(tmp_path) -> None:
    """Without any turn a camera looks down with north on top; pitch 90 raises it to the horizon, heading turns it clockwise."""
    rows = [row("a.png", 1, 2, 3, 0, 0, 0), row("b.png", 1, 2, 3, 0, 90, 0), row("c.png", 1, 2, 3, 90, 90, 0)]
    scene = load_scene(export(tmp_path / "scan", rows))
    assert detect(tmp_path / "scan") == "realityscan" and not scene.metric
    down, north, east = (view.world_from_camera for view in scene.views)
    assert np.allclose(down[:3, 2], [0, 0, -1]) and np.allclose(-down[:3, 1], [0, 1, 0])
    assert np.allclose(north[:3, 2], [0, 1, 0]) and np.allclose(-north[:3, 1], [0, 0, 1])
    assert np.allclose(east[:3, 2], [1, 0, 0]) and np.allclose(east[:3, 3], [1, 2, 3])


def test_points_are_seen_as_the_lens_says(tmp_path) -> None:
    f, px, py, k1, k2, k3, k4, t1, t2 = 27.0, 0.004, -0.011, -0.12, 0.05, -0.01, 0.0, 0.002, -0.001
    folder = export(tmp_path / "scan", [row("a.png", 0, 0, 0, 10, 80, 5, f, px, py, k1, k2, k3, k4, t1, t2)])
    (view,) = load_scene(folder).views
    points = np.random.default_rng(0).uniform([-0.4, -0.3, 1], [0.4, 0.3, 1], (30, 3))
    x, y = points[:, 0], points[:, 1]
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    bent_x = x * radial + t1 * (r2 + 2 * x * x) + 2 * t2 * x * y
    bent_y = y * radial + t2 * (r2 + 2 * y * y) + 2 * t1 * x * y
    seen = np.stack([f / 36 * bent_x + px, f / 36 * bent_y + py], axis=1)  # -0.5 to 0.5 along the longer side
    assert np.allclose(view.camera.project(points), seen * WIDTH + [WIDTH / 2, HEIGHT / 2], atol=1e-9)


def test_a_real_row_is_read(tmp_path) -> None:
    """A row of a published capture, 3840x2880; other importers give it a field of 104 degrees along the longer side."""
    line = (
        "frame_00001.jpeg,44.5876747664166,138.823621534044,6.821916401534405,170.3483067926429,85.18637269312288,"
        "-22.74995074830745,"
        "14.2390682243052,-9.482184385774318e-004,-2.446553068050568e-004,3.114799768048152e-003,4.026391718074555e-003,"
        "-1.795976992379612e-003,0,0,0"
    )
    scene = load_scene(export(tmp_path / "scan", [line], "#cameras 1\n" + HEADER, size=(384, 288)))
    (view,) = scene.views
    assert view.camera.fx == pytest.approx(14.2390682243052 * 384 / 36)
    assert np.rad2deg(2 * np.arctan(192 / view.camera.fx)) == pytest.approx(103.3, abs=0.1)
    assert abs(view.camera.cx - 192) < 0.5 and abs(view.camera.cy - 144) < 0.5
    assert -0.1 < view.world_from_camera[2, 2] < 0  # nearly level, a little down
    assert any("read as Brown's" in note for note in scene.notes)


def test_a_template_may_leave_out_the_lens(tmp_path) -> None:
    folder = export(tmp_path / "scan", ["a.png,1,2,3,0,0,0,36.0"], "#name,x,y,alt,heading,pitch,roll,f")
    (view,) = load_scene(folder).views
    assert view.camera.is_pinhole and (view.camera.fx, view.camera.cx, view.camera.cy) == (160.0, 80.0, 60.0)


def test_a_projected_world_is_moved_to_the_cameras(tmp_path) -> None:
    rows = [row(f"{k}.png", 4.5e5 + k, 5.4e6, 300, 90 * k, 70, 0) for k in range(3)]
    scene = load_scene(export(tmp_path / "scan", rows))
    assert all(np.abs(view.world_from_camera[:3, 3]).max() < 2 for view in scene.views)
    assert any("the world is moved by -450001, -5400000, -300" in note for note in scene.notes)


def test_other_tables_are_not_taken_for_cameras(tmp_path) -> None:
    folder = export(tmp_path / "scan", ["a.png,1,2"], "#name,x,y")
    with pytest.raises(UsageError, match=r"holds no scene.*may hold poses"):
        load_scene(folder)


def test_what_cannot_be_read_is_named(tmp_path) -> None:
    with pytest.raises(DatasetError, match=r"cameras.csv, line 2: row is not complete"):
        load_scene(export(tmp_path / "one", ["a.png,1,2,3,0,0"]))
    with pytest.raises(DatasetError, match=r"fourth radial coefficient.*--undistort"):
        load_scene(export(tmp_path / "two", [row("a.png", 0, 0, 0, 0, 0, 0, 20.0, 0, 0, 0, 0, 0, 0.01, 0, 0)]))
    assert pose.checked(load_scene(tmp_path / "two", any_lens=True).views[0].world_from_camera, where="") is not None
