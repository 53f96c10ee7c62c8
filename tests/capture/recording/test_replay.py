import numpy as np
import pytest

from koala3d.capture.drivers.errors import CaptureError, PlanningError
from koala3d.capture.drivers.measurements import RobotState
from koala3d.capture.model import kinematics
from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.planning import plan
from koala3d.capture.recording.replay import obstacles_around, replay, summary
from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.recording import Frame, Recording

MOUNT = pose.from_rotation_vector([0.2, 0, 0.1], [0, 0.05, 0.08])


class StandInRobot:
    """At once wherever it is sent, its reported flange `off` metres beside where it should be."""

    def __init__(self, joints, off=0.0):
        self.joints, self.off = joints, off

    def __enter__(self):
        return self

    def __exit__(self, *exception): ...

    def stop(self): ...

    def description(self):
        return {}

    def move_to(self, joints, *, speed, acceleration):
        self.joints = np.array(joints)

    def state(self):
        return RobotState(
            kinematics.forward(self.joints) @ pose.rigid(np.eye(3), [0, 0, self.off]), self.joints, np.zeros(6), 0.0, 0
        )


@pytest.fixture
def recording(tmp_path):
    trajectory = load_trajectory("koala_demo")
    description = RigDescription()
    rig = {"name": "sim", **description.model_dump(mode="json")}
    arm = load_arm("ur5e").model_dump(mode="json")
    made = Recording.create(tmp_path / "rec", {"trajectory": trajectory.model_dump(mode="json"), "rig": rig, "arm": arm})
    truth = {}
    for index, view in enumerate(plan(trajectory, description.carrier())[:4]):
        reached = kinematics.forward(view.joints)
        made.append(
            Frame(
                index=index,
                name=view.viewpoint.name,
                split="train",
                image=f"images/{index}.png",
                base_from_flange=reached,
                joints=view.joints,
                robot_time_s=0.0,
                host_time_ns=0,
                device_ticks=0,
                exposure_us=1e4,
                settle_s=0.3,
                sha256="",
            )
        )
        truth[view.viewpoint.name] = (reached @ MOUNT).tolist()
    files.write_json(made.path / "truth" / "poses.json", {"flange_from_camera": MOUNT.tolist(), "base_from_camera": truth})
    return made


def test_deviations_are_those_of_the_arm(recording):
    robot = StandInRobot(recording.frames[0].joints, off=2e-4)
    seen = []
    found = replay(
        recording,
        robot,
        obstacles_around(recording, RigDescription()),
        truth=lambda: kinematics.forward(robot.joints),
        advance=seen.append,
    )
    assert seen == found and [one.frame for one in found] == [frame.name for frame in recording.frames]
    assert all(one.translation_mm == pytest.approx(0.2, abs=1e-6) and one.joints_deg < 1e-9 for one in found)
    assert all(one.true_mm == pytest.approx(0, abs=1e-6) for one in found)  # the premise: recorded truth is where it stands now
    assert summary(found)["translation_mm"]["rms"] == pytest.approx(0.2, abs=1e-6)


def test_a_real_arm_has_no_truth(recording):
    found = replay(recording, StandInRobot(recording.frames[0].joints), obstacles_around(recording, RigDescription()))
    assert all(one.true_mm is None for one in found) and "truly" not in summary(found)["worst"]


def test_an_empty_recording_is_an_error(recording):
    (recording.path / "frames.jsonl").unlink()
    with pytest.raises(CaptureError, match="has no frames"):
        replay(Recording.open(recording.path), StandInRobot(np.zeros(6)), obstacles_around(recording, RigDescription()))


@pytest.mark.parametrize(
    ("rig", "words"),
    [
        (
            {"robot": {"model": "ur10e"}},
            "recorded with another arm .with a UR5e, and this rig has a UR10e.; replay it on the rig",
        ),
        (
            {"flange_from_camera": {"position": [0.0, 0.06, 0.11], "rotation_deg": [55.0, 0.0, 0.0]}},
            r"another mount .what the flange carries is 30.0 mm and 10.0 degrees from where it was",
        ),
        (
            {"beside": {"base_from_camera": {"position": [1, 0, 0.5], "rotation_deg": [0, 90, 0]}}},
            "another mount .its camera was on the flange, and is beside the arm",
        ),
    ],
)
def test_another_arm_or_mount_is_refused(recording, rig, words):
    with pytest.raises(UsageError, match=words):
        obstacles_around(recording, RigDescription.model_validate(rig))


def test_what_stands_around_the_arm_now_is_in_the_way_before_anything_moves(recording):
    robot, lens = (
        StandInRobot(recording.frames[0].joints),
        RigDescription().carrier().base_from_carried(recording.frames[2].joints),
    )
    place = {"position": lens[:3, 3].tolist(), "rotation_deg": [0, 0, 0]}
    post = {"kind": "box", "name": "post", "size": [0.02, 0.02, 0.02], "pose": place}
    obstacles = obstacles_around(recording, RigDescription.model_validate({"obstacles": [post]}))
    with pytest.raises(PlanningError, match=r"view 00\d: a recorded pose is too close .*post"):
        replay(recording, robot, obstacles)
    np.testing.assert_array_equal(robot.joints, recording.frames[0].joints)
