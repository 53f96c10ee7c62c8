"""A view that does not settle is left out, a connection that fails once is opened again; the recording says so."""

import logging
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest

from koala3d.capture.drivers.errors import ConnectionLapse, NotReady, NotSettled, RigConnectionError
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.planning import FIRST_RAD_S, PlannedView
from koala3d.capture.recording.check import check
from koala3d.capture.recording.growing import GrowingRecording
from koala3d.capture.recording.recorder import record
from koala3d.capture.rig.rig import Rig
from koala3d.datasets.building.build import incomplete_notes
from koala3d.datasets.core import files
from koala3d.datasets.incidents import left_out
from koala3d.datasets.recording import Recording
from tests.capture.recording.test_recorder import StandInCamera, StandInRobot


class Shaky(StandInRobot):
    """Raises what `raises` holds, by the number of the order, after the arm has moved; `serial` is what it says of itself."""

    def __init__(self, raises: dict[int, Exception]) -> None:
        super().__init__()
        self.raises, self.orders, self.entered, self.serial = raises, [], 0, "1"
        self.entering: Exception | None = None
        self.next_serial = "1"

    def __enter__(self) -> Self:
        self.entered, self.serial = self.entered + 1, self.next_serial
        if self.entering is not None:
            raise self.entering
        return self

    def move_to(self, joints: np.ndarray, *, speed: float, acceleration: float) -> None:
        super().move_to(joints, speed=speed, acceleration=acceleration)
        self.orders.append((np.array(joints), speed))
        if (error := self.raises.get(len(self.orders))) is not None:
            raise error

    def description(self) -> dict[str, Any]:
        return {"model": "stand-in", "serial": self.serial}


def lapse() -> ConnectionLapse:
    return ConnectionLapse("the robot's data stream stands still", where="here", why="the arm was stopped", remedy="resume")


def unsettled() -> NotSettled:
    return NotSettled("the arm does not come to rest", where="here")


@pytest.fixture
def taken(demo: Trajectory, demo_views: list[PlannedView], tmp_path: Path):
    """Records the first views with an arm; returns the recording."""

    def record_with(robot: Shaky, *, resume: bool = False) -> Recording:
        rig = Rig(robot, StandInCamera(), RigDescription(), "lab", None, {})
        record(demo, rig, tmp_path / "recording", planned=demo_views, resume=resume)
        return Recording.open(tmp_path / "recording")

    return record_with


def names(recording: Recording) -> list[str]:
    return [frame.name for frame in recording.frames]


def steps(views: list[PlannedView], start: int) -> int:
    """Number of the first order of a view, if all before it are taken without incident; the first is reached from home."""
    return 1 + sum(len(view.path) for view in views[:start])


def test_a_view_that_settles_at_the_second_try_is_taken(demo_views, taken):
    robot = Shaky({1: unsettled()})
    recording = taken(robot)
    assert names(recording) == [view.viewpoint.name for view in demo_views] and left_out(recording) == []
    np.testing.assert_array_equal(robot.orders[0][0], robot.orders[1][0])


def test_a_view_that_does_not_settle_is_left_out_and_taken_by_a_resumed_session(demo, demo_views, taken, caplog):
    robot = Shaky({1: unsettled(), 2: unsettled()})
    with caplog.at_level(logging.WARNING):
        recording = taken(robot)
    assert "view 000 is left out, --resume takes it: here: the arm does not come to rest" in caplog.text
    assert names(recording) == [view.viewpoint.name for view in demo_views][1:] and left_out(recording) == ["000"]
    assert [one["what"] for one in recording.manifest["incidents"]] == ["left out"]
    found = [finding.line for finding in check(recording.path)]
    assert "view 000: was never taken (the arm did not come to rest)" in found
    (note,) = incomplete_notes(recording, len(recording.frames))
    assert note.endswith("; the arm did not come to rest at 000")
    again = taken(Shaky({}), resume=True)
    assert sorted(names(again)) == [view.viewpoint.name for view in demo_views] and left_out(again) == []
    assert len(again.manifest["incidents"]) == 1


def test_the_arm_is_entered_once_more_and_goes_on_slowly(demo, demo_views, taken):
    robot = Shaky({2: lapse()})
    recording = taken(robot)
    assert robot.entered == 1 and names(recording) == [view.viewpoint.name for view in demo_views]
    speeds = [speed for _, speed in robot.orders]
    assert speeds[2] <= FIRST_RAD_S == 0.1 < min(speeds[3:])
    (incident,) = recording.manifest["incidents"]
    assert incident["what"] == "connected again" and "stands still" in incident["why"]


@pytest.mark.parametrize("second", ["another lapse", "cannot be entered", "another arm"])
def test_what_fails_twice_ends_the_session_with_the_lapse(taken, second):
    robot = Shaky({2: lapse(), **({4: lapse()} if second == "another lapse" else {})})
    if second == "cannot be entered":
        robot.entering = RigConnectionError("RTDE sends no samples")
    if second == "another arm":
        robot.next_serial = "2"
    with pytest.raises(ConnectionLapse, match="stands still") as caught:
        taken(robot)
    assert robot.entered == 1
    words = {
        "another lapse": "the arm was stopped",
        "cannot be entered": "RTDE sends no samples",
        "another arm": "another serial",
    }
    assert words[second] in str(caught.value)


def test_a_stop_for_safety_is_never_answered_by_going_on(taken):
    robot = Shaky({2: NotReady("the robot is stopped for safety")})
    with pytest.raises(NotReady):
        taken(robot)
    assert robot.entered == 0


def test_a_session_that_chooses_its_views_goes_on_without_one(demo, demo_views, tmp_path):
    robot = Shaky({1: unsettled(), 2: unsettled()})
    rig = Rig(robot, StandInCamera(), RigDescription(), "lab", None, {})
    growing = GrowingRecording(demo, rig, tmp_path / "growing", "capture run")
    for view in demo_views[:3]:
        growing.take(view.joints)
    recording = Recording.open(growing.out)
    assert names(recording) == ["001", "002"] and left_out(recording) == ["000"]
    assert files.read_json(growing.out / "manifest.json")["incidents"][0]["view"] == "000"
    GrowingRecording(demo, rig, growing.out, "capture run").resume()
    assert sorted(names(Recording.open(growing.out))) == ["000", "001", "002"]
