import json
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from koala3d.calib.calibrate import calibrate_handeye
from koala3d.calib.errors import CalibrationError
from koala3d.calib.page.summary import notes
from koala3d.calib.sessions import importer
from koala3d.calib.sessions.description import Description
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets import pose
from koala3d.datasets.core.errors import DatasetError, UsageError

BOARD = {
    "type": "charuco",
    "squares_x": 11,
    "squares_y": 8,
    "square_length_m": 0.03,
    "marker_length_m": 0.022,
    "dictionary": "DICT_5X5_100",
}


def described(**changes):
    plain = {"images": "images/*.png", "poses": "poses.csv", "layout": "x y z rx ry rz", "board": BOARD}
    return Description(**{**plain, **changes})


def unsearched(board, views, **options):
    """A session of all views, whose pictures nobody looked at."""
    return TargetSession(board, 1, 1, [SimpleNamespace(name=name, pose=pose) for name, _, pose in views], np.zeros(0))


def numbers(matrix):
    """As the layout x y z rx ry rz has them."""
    return [*matrix[:3, 3], *pose.rotation_vector(matrix)]


@pytest.fixture
def folder(recorded, tmp_path):
    """(folder with the pictures of a session, names, reported poses)."""
    path, truth = recorded
    (tmp_path / "images").symlink_to(path / "images")
    return tmp_path, [f"{i:03d}" for i in range(12)], truth


def write_poses(folder, names, reported, kind):
    """The same poses in one of the ways that people write them; returns what a description says about it."""
    rows = {name: [float(v) for v in numbers(m)] for name, m in zip(names, reported, strict=True)}
    if kind == "csv":
        lines = ["image, x, y, z, rx, ry, rz", *(f"{n}.png, " + ", ".join(f"{v:.12g}" for v in row) for n, row in rows.items())]
        (folder / "poses.csv").write_text("\n".join(lines))
        return {"poses": "poses.csv"}
    if kind == "list":
        (folder / "poses.yaml").write_text(yaml.safe_dump([{"image": f"{n}.png", "pose": row} for n, row in rows.items()]))
        return {"poses": "poses.yaml"}
    if kind == "mapping":
        (folder / "all.json").write_text(json.dumps({"robot": {"poses": {f"images/{n}.png": row for n, row in rows.items()}}}))
        return {"poses": "all.json", "key": "robot.poses"}
    (folder / "poses").mkdir()
    for name, row in rows.items():
        (folder / "poses" / f"p{name}.yaml").write_text(yaml.safe_dump({"data": [[v] for v in row]}))
    return {"poses": "poses/p*.yaml", "key": "data"}


@pytest.mark.parametrize("kind", ["csv", "list", "mapping", "files"])
def test_poses_are_found_however_they_are_stored(folder, kind, monkeypatch):
    path, names, truth = folder
    monkeypatch.setattr(importer, "observe", unsearched)
    views = importer.import_session(path, described(**write_poses(path, names, truth.reported, kind))).observations
    assert [v.name for v in views] == names
    np.testing.assert_allclose([v.pose for v in views], truth.reported, atol=1e-9)


def test_an_imported_session_is_calibrated_as_a_recorded_one(folder):
    path, names, truth = folder
    said = write_poses(path, names, truth.reported, "csv")
    content = {
        "format": "koala-import",
        "version": 1,
        "images": "images/*.png",
        "layout": "x y z rx ry rz",
        "board": BOARD,
        **said,
    }
    (path / "import.yaml").write_text(yaml.safe_dump(content))
    session, camera = importer.observe_folder(path, path / "import.yaml")
    assert camera is None and importer.count_views(path, path / "import.yaml") == 12
    assert session.unseen == ("011",)
    found = calibrate_handeye(session)
    assert pose.difference(found.flange_from_camera.matrix, truth.flange_from_camera)[0] < 2.5e-4


@pytest.mark.parametrize("suffix", ["csv", "json"])
def test_poses_without_names_are_in_the_order_of_the_pictures(folder, suffix, monkeypatch):
    path, names, truth = folder
    monkeypatch.setattr(importer, "observe", unsearched)
    said = write_unnamed(path, truth.reported, suffix)
    views = importer.import_session(path, described(**said)).observations
    np.testing.assert_allclose([v.pose for v in views], truth.reported, atol=1e-9)
    with pytest.raises(UsageError, match=r"images without a pose.*010, 011.*--leave-out"):
        importer.import_session(path, described(**write_unnamed(path, truth.reported[:-2], suffix)))
    session = importer.import_session(path, described(**said), leave_out=True)
    assert [v.name for v in session.observations] == names[:-2]
    assert session.left_out == dict.fromkeys(names[-2:], "it has no pose; there are 10 for 12 pictures")
    more = np.concatenate([truth.reported, truth.reported[:1]])
    with pytest.raises(UsageError, match=r"more poses than pictures.*13 for 12"):
        importer.import_session(path, described(**write_unnamed(path, more, suffix)))


def write_unnamed(path, poses, suffix):
    """A file of poses in order; returns what the description says of it."""
    rows = [numbers(matrix) for matrix in poses]
    if suffix == "json":
        (path / "unnamed.json").write_text(json.dumps({"poses": [list(map(float, row)) for row in rows]}))
        return {"poses": "unnamed.json", "key": "poses"}
    lines = [",".join(map(repr, map(float, row))) for row in rows]
    (path / "unnamed.csv").write_text("\n".join(["x,y,z,rx,ry,rz", *lines, ""]))
    return {"poses": "unnamed.csv"}


def test_a_pose_missing_in_the_middle_is_named_once_the_last_picture_is_left_out(folder):
    path, names, truth = folder
    fewer = np.delete(truth.reported, 4, axis=0)
    session = importer.import_session(path, described(**write_unnamed(path, fewer, "csv")), leave_out=True)
    with pytest.raises(CalibrationError, match=f"the pose of view {names[4]} may be missing"):
        calibrate_handeye(session)


def test_pictures_without_a_pose_are_left_out_with_a_note(folder, tmp_path):
    path, names, truth = folder
    write_poses(path, names[1:], truth.reported[1:], "csv")
    with pytest.raises(UsageError, match=r"images without a pose.*--leave-out"):
        importer.import_session(path, described())
    session = importer.import_session(path, described(), leave_out=True)
    found = calibrate_handeye(session)
    assert f"view {names[0]} is left out: it has no pose; there are 11 for 12 pictures" in notes(found)
    assert found.provenance["leave_out"] is True and found.residuals.views_used == 10  # the last shows no target


def test_what_is_missing_is_named(folder):
    path, names, truth = folder
    write_poses(path, names[:-2], truth.reported[:-2], "csv")
    with pytest.raises(UsageError, match=r"images without a pose.*010, 011"):
        importer.import_session(path, described())
    with pytest.raises(UsageError, match="no images found"):
        importer.import_session(path, described(images="pictures/*.png"))
    with pytest.raises(UsageError, match="no such file"):
        importer.import_session(path, described(poses="nowhere.json"))
    (path / "other.json").write_text("{}")
    with pytest.raises(DatasetError, match="no key 'a'"):
        importer.import_session(path, described(poses="other.json", key="a.b"))
    (path / "binary.csv").write_bytes(b"image,x\n\xff\xfe,\n")
    with pytest.raises(DatasetError, match="is not a text file"):
        importer.import_session(path, described(poses="binary.csv"))
    (path / "huge.csv").write_text("image,x\n" + 200_000 * "9" + "\n")
    with pytest.raises(DatasetError, match=r"is not a CSV file.*field larger than"):
        importer.import_session(path, described(poses="huge.csv"))
    (path / "short.csv").write_text("image,x,y\n")
    with pytest.raises(DatasetError, match="no column 'z'"):
        importer.import_session(path, described(poses="short.csv"))


def test_a_wrong_unit_in_the_file_is_recognised_from_the_pictures(folder):
    """Metres written as millimetres so small that no number gives them away."""
    path, names, truth = folder
    near = truth.reported.copy()
    near[:, :3, 3] *= 10
    write_poses(path, names, near, "csv")
    session = importer.import_session(path, described())
    with pytest.raises(CalibrationError):
        calibrate_handeye(session)
