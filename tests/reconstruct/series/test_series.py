"""A series from its file to its page: failures, resuming, watching, pieces that stand out."""

import csv
import json
import os
import shutil
import signal
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from koala3d.datasets.core import files, locks
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.recording import Frame, Recording
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.experiments.runner import run_all
from koala3d.reconstruct.output.mesh.files import save
from koala3d.reconstruct.output.shape import files as shape_files
from koala3d.reconstruct.output.shape.comparison import compare
from koala3d.reconstruct.output.shape.stated import Stated
from koala3d.reconstruct.series.file import read
from koala3d.reconstruct.series.run import Shelf, run
from koala3d.reconstruct.series.step import FORMAT, Step
from koala3d.reconstruct.series.watch import Watch, missing_views
from tests.moments import as_soon_as


@pytest.fixture
def shelf(tmp_path: Path, ball_scene: tuple[Scene, Path]) -> Callable[..., Shelf]:
    """Factory of a series of scenes by name, all the ball: a missing picture makes those fail whose names begin with `bad`."""

    def make(*names: str, more: str = "outputs: [eval]\n", watch: Watch | None = None) -> Shelf:
        for name in names:
            if not (scene := tmp_path / "scenes" / name).exists():
                shutil.copytree(ball_scene[1], scene)
                if name.startswith("bad"):
                    (scene / "images" / "004.png").unlink()
        listed = ", ".join(f"scenes/{name}" for name in names)
        (tmp_path / "series.yaml").write_text(f"objects: [{listed}]\n{more}")
        return Shelf(read(tmp_path / "series.yaml"), tmp_path / "out", watch)

    return make


def finish(step: Step, **output: Any) -> None:
    """Leave the result of a step as if it had run."""
    content = {"format": FORMAT, "version": 1, "command": step.command, "seconds": 1.5, "output": output}
    files.write_json(step.result, content)


def finish_all(shelf: Shelf, name: str, shape: Mapping[str, Any] | None = None) -> None:
    """Leave the results of all steps of an object, with the files that its page is made of."""
    for step in shelf.pieces[name].steps:
        finish(step, mean={"psnr": 25.5}, mesh={"chamfer_mm": 0.25}) if step.kind == "eval" else finish(step)
    if shape is not None:
        files.write_json(shelf.pieces[name].place / "compare" / "shape.json", shape)


def shape(rms: float, significant: float = 0.0) -> dict[str, Any]:
    """What `reconstruct compare-shape` writes."""
    deviation = {"mean": 0.1 * rms, "median": 0.0, "rms": rms, "p05": -rms, "p95": 2 * rms, "max": 3 * rms}
    place = {"point_m": [0.41, 0.0, 0.2], "deviation_m": -0.001, "std_m": 1e-4, "area_m2": 1e-4}
    aligned = {"by": "base", "moved_m": 0.0, "turned_deg": 0.0, "scale": 1.003, "scale_std": 0.0004}
    within = {"tolerance_m": 0.0005, "share": 0.98}
    return {
        "aligned": aligned,
        "deviation_m": deviation,
        "within": within,
        "significant_share": significant,
        "places": [place],
    }


def table(shelf: Shelf) -> dict[str, dict[str, Any]]:
    """The objects of the table for programs, by name."""
    content = json.loads((shelf.out / "series.json").read_text())
    return {row["name"]: row for row in content["objects"]}


def test_a_failed_object_stops_no_other_and_is_tried_again(shelf: Callable[..., Shelf], tmp_path: Path) -> None:
    first = shelf("bad_1", "good", "bad_2")
    finish_all(first, "good")
    done = first.pieces["good"].steps[0].result
    before = done.stat().st_mtime_ns
    with pytest.raises(
        ReconstructError, match=r"index.html: 2 of 3 objects failed \(bad_1, check: 'datasets check' finds 1 error: "
    ):
        run(first, run_all)
    assert done.stat().st_mtime_ns == before
    rows = table(first)
    assert [(row["name"], row["state"], row["step"]) for row in rows.values()] == [
        ("bad_1", "failed", "check"), ("bad_2", "failed", "check"), ("good", "done", ""),
    ]  # fmt: skip
    page = (first.out / "index.html").read_text()
    assert page.index("Failures") < page.index("bad_1") < page.index("004.png") < page.index("25.5")
    assert 'href="bad_1/steps/check.log"' in page
    assert [row["state"] for row in csv.DictReader((first.out / "series.csv").open())] == ["failed", "failed", "done"]
    for name in ("bad_1", "bad_2"):
        shutil.copy(tmp_path / "scenes/good/images/004.png", tmp_path / "scenes" / name / "images")
        finish(first.pieces[name].steps[2])
    second = shelf("bad_1", "good", "bad_2")
    for name in ("bad_1", "bad_2"):
        finish(second.pieces[name].steps[1])  # a training of theirs would take longer than all else
    assert [row["state"] for row in run(second, run_all)["objects"]] == ["done", "done", "done"]
    assert second.pieces["bad_1"].steps[0].done and done.stat().st_mtime_ns == before


def test_a_finished_step_is_not_mixed_with_other_settings(shelf: Callable[..., Shelf]) -> None:
    made = shelf("good")
    finish_all(made, "good")
    made.write()
    with pytest.raises(
        UsageError, match=r"out/good/steps/train.json: was run with other settings \(.*train.steps=5 .*choose another"
    ):
        shelf("good", more="outputs: [eval]\nsteps: 5\n")


def test_what_is_no_series_is_not_touched(shelf: Callable[..., Shelf], tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match="out: already exists"):
        shelf("good")


def ball(larger_mm: float) -> trimesh.Trimesh:
    """A ball of 50 mm radius, or a little larger."""
    return trimesh.creation.icosphere(subdivisions=4, radius=0.05 + 1e-3 * larger_mm)


def test_pieces_that_stand_out_are_named(shelf: Callable[..., Shelf]) -> None:
    """The mean of five balls 0, 0.1, 0.1, 0.9 and 0.1 mm too large is 0.24 mm too large."""
    names = [f"cup_{index}" for index in range(5)]
    made = shelf(*names, more="outputs: [eval, mesh, compare]\n")
    finish_all(made, "cup_0")
    save(ball(0.0), made.pieces["cup_0"].place / "mesh.ply")
    for name, larger, share in (("cup_1", 0.1, 0.001), ("cup_2", 0.1, 0.04), ("cup_3", 0.9, 0.002), ("cup_4", 0.1, 0.0)):
        finish_all(made, name)
        place = made.pieces[name].place / "compare"
        shape_files.write(compare(Stated(name, ball(larger)), Stated("cup_0", ball(0.0))), place, "")
        files.write_json(place / "shape.json", shape(1e-3 * larger, share))
    result = run(made, run_all)
    assert len(result["objects"]) == 5
    rows = table(made)
    from_mean = {name: row["figures"]["from_mean_mm"] for name, row in rows.items()}
    assert from_mean == pytest.approx({"cup_0": 0.24, "cup_1": 0.14, "cup_2": 0.14, "cup_3": 0.66, "cup_4": 0.14}, abs=2e-3)
    mean = trimesh.load_mesh(made.out / "mean" / "cup_0.ply", process=False)
    assert np.linalg.norm(mean.vertices, axis=1) == pytest.approx(0.05021, abs=6e-5)  # its facets are flat
    spread = np.asarray(mean.metadata["_ply_raw"]["vertex"]["data"]["spread"]).ravel()
    assert np.median(spread) == pytest.approx(np.std([0, 1e-4, 1e-4, 9e-4, 1e-4]), abs=1e-5)
    out = {name: row["stands_out"] for name, row in rows.items() if row["stands_out"]}
    assert list(out) == ["cup_2", "cup_3"]
    assert out["cup_2"] == "4.0 % of its surface deviates significantly; most at (410, 0, 200) mm, by -1.00 ± 0.10 mm"
    assert out["cup_3"].startswith("it is 0.661 mm from the mean piece (RMS), the others 0.14 mm (median); most at")
    page = (made.out / "index.html").read_text()
    assert "the mean piece is in the folder" in page.lower() and 'href="cup_1/compare/index.html"' in page
    (row,) = [row for row in csv.DictReader((made.out / "series.csv").open()) if row["object"] == "cup_3"]
    assert float(row["deviation_rms_mm"]) == pytest.approx(0.9) and float(row["scale"]) == 1.003
    written = (made.out / "mean" / "cup_0.json").stat().st_mtime_ns
    run(shelf(*names, more="outputs: [eval, mesh, compare]\n"), run_all)
    assert (made.out / "mean" / "cup_0.json").stat().st_mtime_ns == written


@pytest.fixture
def take(tmp_path: Path) -> Callable[..., Path]:
    """Takes views of a recording of three in a folder, and begins it where it is not there yet."""

    def views(name: str, count: int) -> Path:
        place = tmp_path / "arriving" / name
        plan = {"trajectory": {"split": {"train": 2, "test": 1}}}
        recording = Recording.open(place) if place.exists() else Recording.create(place, plan)
        for index in range(len(recording.frames), len(recording.frames) + count):
            recording.append(
                Frame(
                    index=index, name=f"{index:03d}", split="train", image=f"images/{index:03d}.png",
                    base_from_flange=np.eye(4), joints=np.zeros(6), robot_time_s=0.0, host_time_ns=0,
                    device_ticks=0, exposure_us=1e4, settle_s=0.1, sha256="",
                )
            )  # fmt: skip
        return place

    return views


def test_recordings_are_taken_as_soon_as_they_are_complete(
    shelf: Callable[..., Shelf], take: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Their calibration is empty, so that building their scenes fails at once."""
    (tmp_path / "calibration.json").write_text("{}")
    assert missing_views(take("cup_1", 3)) == 0 and missing_views(take("cup_2", 1)) == 2 and take("cup_3", 2)
    (tmp_path / "arriving" / "notes").mkdir()
    more = "calibration: calibration.json\noutputs: [eval]\n"
    watched = shelf(more=more, watch=Watch(tmp_path / "arriving", idle_s=1.0))
    went_on = lambda: take("cup_2", 2) if (tmp_path / "out/cup_1/steps/build.log").exists() else None  # noqa: E731
    with as_soon_as(went_on, lambda: None, "the first step"), pytest.raises(ReconstructError, match="2 of 2 objects failed"):
        run(watched, run_all)
    assert {name: row["step"] for name, row in table(watched).items()} == {"cup_1": "build", "cup_2": "build"}
    assert "calibration.json" in table(watched)["cup_1"]["error"]
    assert "cup_3: not taken, 1 views of its recording are missing" in capsys.readouterr().err
    assert list(shelf(more=more).pieces) == ["cup_1", "cup_2"], "they belong to the series from now on"


def test_ctrl_c_ends_watching_and_keeps_the_page(shelf: Callable[..., Shelf], tmp_path: Path, ctrl_c: None) -> None:
    (tmp_path / "arriving").mkdir()
    (tmp_path / "calibration.json").write_text("{}")
    watched = shelf("good", more="calibration: calibration.json\noutputs: [eval]\n", watch=Watch(tmp_path / "arriving", None))
    finish_all(watched, "good")
    page = watched.out / "index.html"
    with as_soon_as(page.exists, lambda: os.kill(os.getpid(), signal.SIGINT), "the page"):
        assert [row["state"] for row in run(watched, run_all)["objects"]] == ["done"]
    assert "25.5" in page.read_text()


def test_watching_needs_a_calibration(shelf: Callable[..., Shelf], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"'calibration' is missing .--watch finds recordings"):
        shelf(watch=Watch(tmp_path, None))


def test_a_series_is_run_by_one_process(shelf: Callable[..., Shelf]) -> None:
    made = shelf("good")
    finish_all(made, "good")
    with locks.beside(made.out, "series"), pytest.raises(UsageError, match=r"series is in use .by .* process"):
        run(made, run_all)
