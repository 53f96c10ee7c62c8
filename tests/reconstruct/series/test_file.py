"""The file of a series: what is enough, what becomes of it, and every mistake in one line."""

from pathlib import Path

import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.recording import Recording
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.series.file import read
from koala3d.reconstruct.series.plan import Times, plan


@pytest.fixture
def folder(tmp_path: Path, ball_scene: tuple[Scene, Path]) -> Path:
    """A folder with two recordings, a scene, a calibration and a drawing."""
    for name in ("cup_1", "cup_2"):
        Recording.create(tmp_path / "recordings" / name, {})
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes" / "ball").symlink_to(ball_scene[1])
    (tmp_path / "calibration.json").write_text("{}")
    (tmp_path / "cup.stl").write_text("solid")
    return tmp_path


def commands(folder: Path, text: str) -> dict[str, list[str]]:
    """The planned commands of each object of a series."""
    (folder / "series.yaml").write_text(text)
    pieces = plan(read(folder / "series.yaml"), folder / "out")
    return {name: [step.command for step in piece.steps] for name, piece in pieces.items()}


def test_recordings_and_a_calibration_are_enough(folder: Path) -> None:
    found = commands(folder, "objects: [recordings/cup_1, recordings/cup_2]\ncalibration: calibration.json\n")
    assert list(found) == ["cup_1", "cup_2"]
    assert found["cup_1"] == [
        "datasets build recordings/cup_1 --calibration calibration.json --out out/cup_1/scene",
        "datasets mask out/cup_1/scene --out out/cup_1/masked",
        "datasets check out/cup_1/masked",
        "reconstruct train out/cup_1/masked --model surfnerf --preset fast --out out/cup_1/run",
        "reconstruct eval out/cup_1/run",
        "reconstruct mesh out/cup_1/run --out out/cup_1/mesh.ply",
        "reconstruct report out/cup_1/run --calibration calibration.json --out out/cup_1/report",
    ]


def test_recordings_are_trained_as_they_are_without_masks(folder: Path) -> None:
    found = commands(folder, "objects: [recordings/cup_1]\ncalibration: calibration.json\nmask: false\n")["cup_1"]
    assert found[1] == "datasets check out/cup_1/scene" and found[2].startswith("reconstruct train out/cup_1/scene")


def test_objects_are_compared_with_those_that_they_are_like(folder: Path) -> None:
    found = commands(
        folder,
        "objects: {a: scenes/ball, b: scenes/ball, c: {path: scenes/ball, like: b}, d: {path: scenes/ball, like: b}}\n"
        "drawing: cup.stl\noutputs: [compare]\ncheck: none\n",
    )
    others = {name: steps[-1].split()[3] for name, steps in found.items()}
    assert others == {"a": "cup.stl", "b": "cup.stl", "c": "out/b/run", "d": "out/b/run"}


def test_everything_that_objects_share_reaches_their_commands(folder: Path) -> None:
    found = commands(
        folder,
        "objects: {first: scenes/ball, second: {path: scenes/ball, drawing: cup.stl}, third: scenes/ball}\n"
        "outputs: [mesh, asset, compare]\nmodel: zipnerf\nscale: 0.5\nsteps: 700\nsettings: [train.seed=3]\n"
        "check: none\nfrom_first: true\nstands_on: -z\ntolerance_m: 0.0005\n",
    )
    options = "--set train.seed=3 --set scale=0.5 --set train.steps=700"
    assert found["first"] == [
        f"reconstruct train scenes/ball --model zipnerf --preset fast {options} --out out/first/run",
        "reconstruct mesh out/first/run --stands-on -z --out out/first/mesh.ply",
        "reconstruct asset out/first/run --stands-on -z --out out/first/asset.glb",
    ]
    assert found["second"][0] == f"reconstruct train scenes/ball --from out/first/run {options} --out out/second/run"
    compared = ["reconstruct compare-shape out/{0}/run {1} --stands-on -z --tolerance 0.0005 --out out/{0}/compare"]
    assert found["second"][3:] == [compared[0].format("second", "cup.stl")]
    assert found["third"][3:] == [compared[0].format("third", "out/first/run")]


@pytest.mark.parametrize(("text", "complaint"), [
    ("objects: [recordings/cup_1]\n", r"series.yaml: key 'calibration' is missing \(cup_1 is a recording\)"),
    ("objects: [recordings/cup_3]\n", r"objects.cup_3: there is no folder 'recordings/cup_3'; paths are relative to"),
    ("objects: [scenes/ball, recordings/../scenes/ball]\n", r"line 1: key 'objects': two objects are called 'ball': give"),
    ("objects: {a/b: scenes/ball}\n", r"'a/b' is no name of an object"),
    ("objects: {a: {path: scenes/ball, drawing: cup.obj}}\n", r"objects.a: there is no drawing 'cup.obj'"),
    ("objects: {a: scenes/ball, b: {path: scenes/ball, like: b}}\n", r"objects.b: like: there is no other object 'b'"),
    ("objects: {a: scenes/ball, b: {path: scenes/ball, like: a, drawing: c}}\n", r"drawing and like exclude each other"),
    ("objects: [scenes/ball]\ncalibraton: x\n", r"line 2: unknown key 'calibraton'; did you mean 'calibration'"),
    ("objects: [scenes/ball]\ncalibration: none.json\n", r"calibration: there is no file 'none.json'"),
    ("objects: [scenes/ball]\noutputs: [mash]\n", r"line 2: key 'outputs.0'.*'mesh'"),
    ("objects: [scenes/ball]\nsteps: 5\nbudget_s: 5\n", r"steps and budget_s exclude each other: keep one"),
    ("objects: [scenes/ball]\ntolerance_m: 0.1\n", r"tolerance_m is for compare: add it to outputs"),
    ("objects: [scenes/ball]\nmodel: zipnrf\n", r"did you mean 'zipnerf'"),
    ("objects: [scenes/ball]\nsettings: [k=1]\n", r"unknown key 'k'"),
    ("objects: [scenes/ball]\nneeds: {train: {cores: 2.5}}\n", r"line 2: key 'needs.train': cores: more than one is"),
    ("objects: [scenes/ball]\nneeds: {train: {core: 2}}\n", r"line 2: unknown key 'needs.train.core'; did you mean 'cores'"),
])  # fmt: skip
def test_a_mistake_is_one_line(folder: Path, text: str, complaint: str) -> None:
    with pytest.raises(UsageError, match=complaint) as raised:
        commands(folder, text)
    assert "\n" not in str(raised.value)


def test_the_work_left_is_measured_where_it_can_be(folder: Path) -> None:
    (folder / "series.yaml").write_text("objects: [scenes/ball]\ncheck: none\noutputs: [eval]\nbudget_s: 100\n")
    (piece,) = plan(read(folder / "series.yaml"), folder / "out").values()
    train, evaluation = piece.steps
    times = Times(100.0)
    assert times.with_left(piece, train).left_s == 130 + 20
    for seconds in (3.0, 4.0, 50.0):
        times.add("eval", seconds)
    assert times.with_left(piece, train).left_s == 134 and times.with_left(piece, evaluation).left_s == 4
