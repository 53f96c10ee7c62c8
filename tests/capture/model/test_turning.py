"""Turntable angles of trajectories, what the planner makes of them, and how they are recorded."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.drivers.errors import UnreachableError
from koala3d.capture.model.rig import RigDescription, load_rig
from koala3d.capture.model.trajectory import Trajectory, load_trajectory
from koala3d.capture.planning import Obstacles, duration, plan
from koala3d.capture.recording.check import check
from koala3d.capture.recording.manifest import require_same_session
from koala3d.capture.recording.recorder import record
from koala3d.capture.rig.naming import describe
from koala3d.capture.rig.rig import Rig
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.recording import Recording
from tests.capture.recording.test_recorder import StandInCamera, StandInRobot

TURNTABLE = {"base_from_turntable": {"position": [0.4, 0.0, 0.0]}, "max_deg": 400.0}
RIG = RigDescription.model_validate({"turntable": TURNTABLE, "lights": [{"name": "key"}, {"name": "ring", "stands": "flange"}]})
SMALL = ["views.0.count=2", "views.0.rings=2", "views.0.turntable.steps=3", "split=null"]


class StandInTable:
    """A table that is at once where it is told to be, to half a millidegree; knows every angle that it was told."""

    def __init__(self) -> None:
        self.told, self.slips, self.looks = [], 0.0, 0

    def turn_to(self, angle: float) -> None:
        self.told.append(angle)

    def angle(self) -> float:
        self.looks += 1
        return self.told[-1] + np.radians(0.0005) + self.slips * self.looks

    def description(self):
        return {"driver": "stand-in"}


@pytest.fixture
def small() -> Trajectory:
    return load_trajectory("koala_turntable", overrides=SMALL)


@pytest.fixture
def rig() -> Rig:
    camera = StandInCamera()
    extra = {"scene": "gold_head", "seed": 0}
    return Rig(StandInRobot(), camera, RIG, "sim", camera, extra, turntable=StandInTable())


def test_every_view_is_taken_at_every_angle_to_and_fro(small):
    views = small.viewpoints()
    assert len(views) == small.number == 6 and small.turns
    np.testing.assert_allclose(np.degrees([view.turntable for view in views]), [0, 120, 240, 254, 134, 14])
    assert [view.name for view in views] == ["000", "001", "002", "003", "004", "005"]
    assert len({view.base_from_camera.tobytes() for view in views}) == 2


def test_pairs_and_views_without_a_table(small):
    content = small.model_dump(mode="json")
    content["views"][0]["turntable"] = {"angles_deg": [10, 20], "take": "pairs"}
    content["views"].append({**content["views"][0], "turntable": None})
    views = Trajectory.model_validate(content).viewpoints()
    np.testing.assert_allclose(np.degrees([view.turntable for view in views]), [10, 20, 0, 0])
    assert not load_trajectory("koala_demo").turns
    assert {view.turntable for view in load_trajectory("koala_demo").viewpoints()} == {None}


@pytest.mark.parametrize(
    ("turntable", "message"),
    [
        ({}, "give either steps or angles_deg"),
        ({"steps": 3, "angles_deg": [1.0]}, "give either steps or angles_deg"),
        ({"angles_deg": [1.0, 2.0, 3.0], "take": "pairs"}, "group 0: turntable has 3 angles for 2 views"),
        ({"steps": 2, "take": "pairs", "shift_deg": 5}, "shift_deg is for take: each"),
    ],
)
def test_impossible_angles_are_explained(small, turntable, message):
    content = small.model_dump(mode="json")
    content["views"][0]["turntable"] = turntable
    with pytest.raises(ValueError, match=message):
        Trajectory.model_validate(content)


def test_the_planner_refuses_a_rig_without_table_and_angles_beyond_its_limits(small):
    with pytest.raises(UsageError, match=r"the rig has no turntable.*describe one under 'turntable'"):
        plan(small, RigDescription().carrier())
    far = load_trajectory("koala_turntable", overrides=[*SMALL, "views.0.turntable.range_deg=[0,720]"])
    with pytest.raises(UnreachableError, match=r"2 of 6 views.*turntable angle 480.0 degrees, limits -3600 to 400"):
        plan(far, RIG.carrier())


def test_the_arm_keeps_clear_of_the_object_at_every_angle(small):
    low, high = Obstacles.of(small, RIG.carrier()).object_corners
    reach = np.hypot(0.13, 0.13)  # of the corners of a box of 0.26 m about an axis through its middle
    np.testing.assert_allclose([low, high], [[0.4 - reach, -reach, 0], [0.4 + reach, reach, 0.3]])
    still = load_trajectory("koala_demo")
    np.testing.assert_allclose(Obstacles.of(still, RIG.carrier()).object_corners, still.object.corners)


def test_turning_takes_time(small):
    planned = plan(small, RIG.carrier())
    turned = np.abs(np.diff([0.0, *(view.viewpoint.turntable for view in planned)]))
    expected = turned.sum() / 0.5 + 0.5 * np.count_nonzero(turned)
    longer = duration(small, planned, RIG.carrier()) - duration(small, planned, replace(RIG.carrier(), turntable=None))
    assert longer == pytest.approx(expected)


def test_angles_and_lamps_are_recorded_and_the_arm_stands_still(small, rig, tmp_path):
    planned = plan(small, RIG.carrier())
    record(small, rig, tmp_path / "rec", planned=planned)
    recording = Recording.open(tmp_path / "rec")
    assert rig.turntable.told == [view.viewpoint.turntable for view in planned] and recording.turns
    for frame, view in zip(recording.frames, planned, strict=True):
        assert frame.turntable_angle == pytest.approx(view.viewpoint.turntable, abs=1e-4)
        assert frame.turntable_angle_after == frame.turntable_angle
        assert frame.lights == ("key", "ring")
    assert rig.robot.moves <= 2 + sum(len(view.path) - 1 for view in planned)  # once for each place, not for each angle
    assert recording.manifest["turntable"] == {"driver": "stand-in"}
    assert [finding.line for finding in check(tmp_path / "rec") if "turntable" in finding.what] == []


def test_a_stopped_session_is_resumed_at_its_angles(small, rig, tmp_path):
    planned, camera = plan(small, RIG.carrier()), rig.camera
    camera.stop_at = 2
    with pytest.raises(KeyboardInterrupt):
        record(small, rig, tmp_path / "rec", planned=planned)
    assert len(Recording.open(tmp_path / "rec").frames) == 2
    camera.stop_at, rig.turntable.told = float("inf"), []
    frames = record(small, rig, tmp_path / "rec", planned=planned, resume=True).frames
    assert rig.turntable.told == [view.viewpoint.turntable for view in planned[2:]]
    assert [frame.name for frame in frames] == [view.viewpoint.name for view in planned]
    elsewhere = RIG.turntable.model_copy(update={"address": "192.168.0.20:23"})
    moved = Rig(rig.robot, camera, RIG.model_copy(update={"turntable": elsewhere}), "lab", camera, rig.extra, rig.turntable)
    require_same_session(Recording.open(tmp_path / "rec"), small, moved)  # the same table at another address
    faster = RIG.model_copy(update={"turntable": RIG.turntable.model_copy(update={"units_per_turn": 36.0})})
    with pytest.raises(UsageError, match="was taken with another rig"):
        require_same_session(Recording.open(tmp_path / "rec"), small, Rig(rig.robot, camera, faster, "", camera, rig.extra))


def test_a_table_that_slips_during_the_exposure_is_found(small, rig, tmp_path):
    rig.turntable.slips = np.radians(0.05)  # from one look to the next
    record(small, rig, tmp_path / "rec", planned=plan(small, RIG.carrier()))
    found = [finding for finding in check(tmp_path / "rec") if finding.what == "the turntable moved during the exposure"]
    assert len(found) == 6 and found[0].again


def test_lamps_are_checked(tmp_path: Path):
    assert RIG.lights_on(None) == ("key", "ring") and RIG.lights_on(["ring"]) == ("ring",) and RIG.lights_on([]) == ()
    assert RigDescription().lights_on(None) is None
    with pytest.raises(UsageError, match=r"no lamp called 'rign'.*the rig file has key, ring"):
        RIG.lights_on(["rign"])
    (tmp_path / "rig.yaml").write_text("lights:\n  - {name: key, stands: ceiling}\n")
    with pytest.raises(UsageError, match=r"line 2.*stands"):
        load_rig(tmp_path / "rig.yaml")
    riding = RigDescription.model_validate({"lights": [{"name": "ring", "stands": "turntable"}]})
    with pytest.raises(UsageError, match=r"'ring' stands on the turntable.*no turntable"):
        riding.lights_on(None)


def test_the_shipped_trajectories_fit_the_shipped_rig():
    carrier, one = describe("ur5e_turntable").carrier(), "views.0.turntable.steps=1"
    for name, number, places in (("koala_turntable", 50, 5), ("calibration_turntable", 36, 3)):
        assert load_trajectory(name).number == number
        assert len(plan(load_trajectory(name, overrides=[one, "split=null"]), carrier)) == places
