"""`reconstruct compare-shape` from files to its folder."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.reconstruct.cli import main
from koala3d.reconstruct.output.mesh import files as mesh_files
from koala3d.reconstruct.output.shape import pictures, stated
from tests.reconstruct.output.shape.test_comparison import DENT, DRAWN, NOISE, PLACE, piece


@pytest.fixture(scope="module")
def pieces(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dented piece as `reconstruct mesh` writes it, and its drawing in millimetres."""
    folder = tmp_path_factory.mktemp("pieces")
    dented = piece(dent=DENT)
    assert dented.deviation is not None and dented.common is not None and dented.known is not None
    dented.mesh.vertex_attributes["deviation"] = dented.deviation.astype(np.float32)
    dented.mesh.vertex_attributes["common"] = dented.common.astype(np.float32)
    dented.mesh.vertex_attributes["known"] = dented.known.astype(np.uint8)
    mesh_files.save(dented.mesh, folder / "piece.ply")
    DRAWN.copy().apply_scale(1000).export(folder / "drawing.stl")
    return folder


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Compare with these words; returns exit code, output and errors."""

    def run(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["reconstruct", "compare-shape", *map(str, words)])
        with pytest.raises(SystemExit) as stop:
            main()
        captured = capsys.readouterr()
        return int(stop.value.code or 0), captured.out, captured.err

    return run


def test_it_writes_figures_mesh_and_page(pieces: Path, tmp_path: Path, command: Callable[..., tuple[int, str, str]]) -> None:
    words = (pieces / "piece.ply", pieces / "drawing.stl", "--unit", "mm", "--out", tmp_path / "found", "--json")
    code, out, _ = command(*words)
    assert code == 0
    found = json.loads((tmp_path / "found" / "shape.json").read_text())
    assert json.loads(out) == {"out": str(tmp_path / "found")} | found
    assert set(found["aligned"]) >= {"by", "moved_m", "turned_deg", "scale", "scale_std"}
    assert set(found["deviation_m"]) == {"mean", "median", "rms", "p05", "p95", "max"}
    assert found["within"]["tolerance_m"] == 1e-3 and found["within"]["share"] > 0.99
    (place,) = found["places"]
    assert np.linalg.norm(np.subtract(place["point_m"], PLACE)) < 2e-3 and set(place) == {
        "point_m",
        "deviation_m",
        "std_m",
        "area_m2",
    }
    assert abs(place["deviation_m"] + DENT) < 1.96 * place["std_m"]
    mesh = trimesh.load_mesh(tmp_path / "found" / "deviation.ply", process=False)
    vertices = mesh.metadata["_ply_raw"]["vertex"]["data"]
    assert np.std(vertices["distance"]) == pytest.approx(NOISE, rel=0.1) and (vertices["compared"] == 1).all()
    blue = np.asarray(mesh.visual.vertex_colors)[np.linalg.norm(np.asarray(mesh.vertices) - PLACE, axis=-1).argmin()]
    assert blue[2] > blue[0] + 50, "inside the drawing"
    page = (tmp_path / "found" / "index.html").read_text()
    assert page.count("data:image/png") >= 2 * len(pictures.SIDES) and "<svg" in page and 'src="http' not in page
    code, _, err = command(*words)
    assert code == 2 and "already exists" in err


def test_what_a_mesh_states_is_read(pieces: Path) -> None:
    found = stated.read(pieces / "piece.ply")
    assert found.deviation == pytest.approx(NOISE, rel=1e-6) and found.known is not None and found.known.all()
    drawn = stated.read(pieces / "drawing.stl", unit="mm")
    assert drawn.deviation is None and len(drawn.mesh.vertices) == len(DRAWN.vertices), "three vertices a triangle are merged"
    assert drawn.size == pytest.approx(float(np.linalg.norm(DRAWN.extents)), rel=1e-6)


def test_what_is_no_shape_is_refused(tmp_path: Path, pieces: Path, command: Callable[..., tuple[int, str, str]]) -> None:
    trimesh.PointCloud(DRAWN.vertices).export(tmp_path / "points.ply")
    trimesh.Trimesh([[0, 0, 0], [0, 0, 1], [0, 0, 2]], [[0, 1, 2]], process=False).export(tmp_path / "line.ply")
    for name, what in (("points", "holds no mesh"), ("line", "mesh is empty")):
        with pytest.raises(DatasetError, match=what):
            stated.read(tmp_path / f"{name}.ply")
    with pytest.raises(UsageError, match="neither a mesh nor a run"):
        stated.read(tmp_path)
    for words, what in (
        (("--unit", "ell"), "there is no unit 'ell'"),
        (("--align", "hand"), "there is no way 'hand'"),
        ((), "unit is probably not the metre"),
    ):
        code, _, err = command(pieces / "piece.ply", pieces / "drawing.stl", "--out", tmp_path / "x", *words)
        assert code == 2 and what in err and len(err.strip().splitlines()) == 1 and not (tmp_path / "x").exists()


def test_pictures_show_the_side_that_is_named() -> None:
    """A red end at +x."""
    rod = trimesh.creation.box((0.1, 0.02, 0.02)).subdivide().subdivide().subdivide()
    tone = pictures.colours(np.where(rod.vertices[:, 0] > 0.04, 1.0, -1.0), 1.0)
    seen = pictures.views(rod, tone)
    middle = pictures.PIXELS // 2
    red = lambda pixel: int(pixel[0]) > int(pixel[2]) + 50  # noqa: E731
    assert red(seen["from +x"][middle, middle]) and not red(seen["from -x"][middle, middle])
    edge = int(pictures.PIXELS * 0.9)
    assert red(seen["from -y"][middle, edge]) and not red(seen["from -y"][middle, pictures.PIXELS - edge])
    assert (seen["from -y"][5, 5] == 255).all()
