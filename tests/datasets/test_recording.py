import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.recording import FRAMES, Frame, Recording


def frame(index: int) -> Frame:
    return Frame(
        index=index,
        name=f"{index:03d}",
        split="train",
        image=f"images/{index:03d}.png",
        base_from_flange=pose.from_rotation_vector((0.1, 0.2, index)),
        joints=np.arange(6.0),
        robot_time_s=1.5,
        host_time_ns=10**18 + index,
        device_ticks=7,
        exposure_us=1e4,
        settle_s=0.3,
        sha256="",
    )


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    recording = Recording.create(tmp_path / "rec", {"trajectory": {"name": "t"}})
    for index in range(3):
        recording.append(frame(index))
    return recording


def test_frames_come_back(recording: Recording) -> None:
    again = Recording.open(recording.path)
    assert [f.name for f in again.frames] == ["000", "001", "002"] and again.trajectory == {"name": "t"}
    assert np.abs(again.frames[2].base_from_flange - frame(2).base_from_flange).max() < 1e-15
    assert again.frames[1].host_time_ns == 10**18 + 1  # does not fit a float


def test_the_pose_after_an_exposure_comes_back_and_is_checked(recording: Recording) -> None:
    moved = {"base_from_flange_after": np.eye(4), "joints_after": np.ones(6), "robot_time_after_s": 1.7}
    recording.append(replace(frame(3), **moved))
    again = Recording.open(recording.path).frames
    assert again[2].joints_after is None  # a line from before it was kept has no such key either
    assert again[3].robot_time_after_s == 1.7 and np.array_equal(again[3].joints_after, np.ones(6))
    old = {key: value for key, value in frame(4).to_json().items() if not key.endswith(("after", "after_s"))}
    assert Frame.from_json(old, where="here").base_from_flange_after is None
    whole = replace(frame(4), **moved).to_json()
    for damage in ({"joints_after": [1.0]}, {"robot_time_after_s": None}, {"base_from_flange_after": [1.0]}):
        with pytest.raises(DatasetError):
            Frame.from_json(whole | damage, where="here")


@pytest.mark.parametrize("cut", [1, 20, 200])
def test_an_incomplete_last_line_is_dropped_and_recorded_again(recording: Recording, cut: int) -> None:
    path = recording.path / FRAMES
    path.write_bytes(path.read_bytes()[:-cut])
    resumed = Recording.open(recording.path)
    assert [f.name for f in resumed.frames] == ["000", "001"]
    resumed.append(frame(2))
    resumed.append(frame(3))
    assert [f.name for f in Recording.open(recording.path).frames] == ["000", "001", "002", "003"]
    assert len(path.read_text().splitlines()) == 4


def test_damage_in_the_middle_names_the_line(recording: Recording) -> None:
    path = recording.path / FRAMES
    lines = path.read_text().splitlines(keepends=True)
    path.write_text(lines[0] + lines[1][:50] + "\n" + lines[2])
    with pytest.raises(DatasetError, match="line 2"):
        Recording.open(recording.path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"base_from_flange": np.full((4, 4), np.nan).tolist()}, "not finite"),
        ({"joints": [1, 2]}, "6 finite"),
        ({"image": "../../x.png"}, "leaves the folder"),
        ({"colour": 1}, "not complete"),
        ({"name": 7}, "name is 7"),
        ({"split": None}, "split is None"),
        ({"index": "2"}, "index is '2'"),
        ({"device_ticks": 10**40}, "device_ticks is 1000"),
        ({"exposure_us": float("nan")}, "exposure_us is nan"),
        ({"settle_s": float("inf")}, "settle_s is inf"),
        ({"host_time_ns": []}, "not complete"),
        ({"depth": {"file": 7, "sha256": ""}}, "depth is"),
        ({"depth": {"file": "depth/000.png"}}, "not complete"),
        ({"depth": {"file": "../../depth.png", "sha256": ""}}, "leaves the folder"),
    ],
)
def test_impossible_frames_are_refused(recording: Recording, change: dict, words: str) -> None:
    path = recording.path / FRAMES
    path.write_text(json.dumps(frame(0).to_json() | change) + "\n")
    with pytest.raises(DatasetError, match=words) as caught:
        Recording.open(recording.path)
    assert "line 1" in str(caught.value)


def test_a_frame_that_json_cannot_hold_is_not_written(recording: Recording) -> None:
    with pytest.raises(ValueError):
        recording.append(replace(frame(3), settle_s=np.nan))
    assert len(Recording.open(recording.path).frames) == 3


def test_create_and_open_refuse(recording: Recording, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="already exists"):
        Recording.create(recording.path, {})
    with pytest.raises(UsageError, match="is not a recording"):
        Recording.open(tmp_path)


def test_frames_of_another_session_are_never_cut_off(recording: Recording) -> None:
    """One that knows three of eight frames must not make them four."""
    early = Recording.open(recording.path)
    for index in range(3, 8):
        recording.append(frame(index))
    with pytest.raises(DatasetError, match=r"another process records here \(it holds more than the 3 frames"):
        early.append(frame(3))
    assert [f.name for f in Recording.open(recording.path).frames] == [f"{index:03d}" for index in range(8)]


def test_the_time_of_day_and_temperatures_are_kept_and_older_frames_have_none():
    plain = {
        "index": 0,
        "name": "000",
        "split": "train",
        "image": "images/000.png",
        "base_from_flange": np.eye(4).tolist(),
        "joints": [0.0] * 6,
        "robot_time_s": 1.0,
        "host_time_ns": 2,
        "device_ticks": 3,
        "exposure_us": 1e4,
        "settle_s": 0.3,
        "sha256": "",
    }
    older = Frame.from_json(plain, where="a test")
    assert older.wall_time is None and older.joint_temperatures is None
    told = {"wall_time": "2026-11-28T02:38:30.123456Z", "joint_temperatures": [25.0, 26.5, 27.0, 25.0, 25.0, 25.0]}
    newer = Frame.from_json({**plain, **told}, where="a test")
    assert newer.wall_time == told["wall_time"] and newer.joint_temperatures == tuple(told["joint_temperatures"])
    assert Frame.from_json(json.loads(json.dumps(newer.to_json())), where="a test").to_json() == newer.to_json()
    for wrong in (
        {"wall_time": "yesterday"},
        {"wall_time": 5},
        {"joint_temperatures": ["warm"]},
        {"joint_temperatures": [1e300]},
    ):
        with pytest.raises(DatasetError, match="frame record is not complete"):
            Frame.from_json({**plain, **wrong}, where="a test")
