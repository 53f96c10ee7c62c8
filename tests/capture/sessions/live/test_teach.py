"""Steps along the camera's axes, and views that are shown: the file is one that the planner takes."""

from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.drivers.errors import CaptureError, UnreachableError
from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import Trajectory, load_trajectory
from koala3d.capture.planning import Obstacles, plan
from koala3d.capture.sessions.live.jog import Jog
from koala3d.capture.sessions.live.teach import Teaching
from koala3d.capture.sim.kinematic_arm import KinematicArm
from koala3d.datasets import pose
from koala3d.datasets.core.errors import UsageError

CARRIER = RigDescription().carrier()


@pytest.fixture(scope="module")
def session() -> Trajectory:
    return load_trajectory("koala_demo", overrides=["camera.width=96", "camera.height=64"])


@pytest.fixture
def jog(session):
    with KinematicArm(load_arm("ur5e"), time_scale=200.0) as arm:
        found = Jog(arm, session, CARRIER)
        found.go("020")
        yield found


def camera(jog: Jog) -> np.ndarray:
    return CARRIER.base_from_camera(jog.robot.state().joints)


@pytest.mark.parametrize("shift", [(0.02, 0, 0), (0, -0.02, 0), (0, 0, 0.02), (0.01, 0.01, -0.01)])
def test_a_step_moves_along_the_cameras_axes(jog, shift):
    before = camera(jog)
    jog.step(shift)
    moved = pose.inverse(before) @ camera(jog)
    np.testing.assert_allclose(moved[:3, 3], shift, atol=1e-4)  # encoders: 4 urad at 0.9 m
    assert np.linalg.norm(pose.rotation_vector(moved)) < 1e-4


@pytest.mark.parametrize("turn", [(0.05, 0, 0), (0, -0.05, 0), (0, 0, 0.1)])
def test_a_turn_leaves_the_lens_where_it_is(jog, turn):
    before = camera(jog)
    jog.step((0, 0, 0), turn)
    moved = pose.inverse(before) @ camera(jog)
    np.testing.assert_allclose(pose.rotation_vector(moved), turn, atol=1e-4)
    assert np.linalg.norm(moved[:3, 3]) < 1e-4


def test_a_step_into_something_or_out_of_reach_moves_nothing(jog):
    with pytest.raises(CaptureError, match=r"no path|too close"):
        for _ in range(8):  # into the object, 0.4 m away
            before = jog.robot.state().joints
            jog.step((0, 0, 0.05))
    with pytest.raises(UnreachableError, match="cannot take this step"):
        jog.step((0, 0, -1.0))
    np.testing.assert_array_equal(jog.robot.state().joints, before)


def test_a_motion_ends_freedrive_first(jog):
    assert jog.can_be_freed
    jog.free(True)
    assert jog.is_free and jog.robot._arm.freedrive
    jog.step((0.005, 0, 0))
    assert not jog.is_free and not jog.robot._arm.freedrive
    jog.free(True)
    jog.stop()
    assert not jog.is_free


def test_views_that_are_shown_become_a_trajectory(jog, session, tmp_path):
    teaching = Teaching(tmp_path / "my views.yaml", session, jog.obstacles)
    names = []
    for shift in ((0, 0, 0), (0.03, 0, 0), (0, 0.03, -0.02)):
        jog.step(shift)
        names.append(teaching.take(jog.robot.state().joints))
    assert names == ["000", "001", "002"] and not list(tmp_path.glob(".*"))
    found = load_trajectory(tmp_path / "my views.yaml")
    assert found.name == "my_views" and found.split is None and found.object == session.object
    assert found.camera == session.camera and found.motion == session.motion and found.safety == session.safety
    assert len(found.views) == 1 and found.number == 3
    planned = plan(found, CARRIER)
    np.testing.assert_allclose(planned[2].joints, jog.robot.state().joints, atol=2e-5)  # encoders' noise

    with pytest.raises(UsageError, match=r"view 002 sees the same.*0\.0 mm"):
        teaching.take(jog.robot.state().joints)
    jog.step((0.0015, 0, 0))
    with pytest.raises(UsageError, match="view 002 sees the same"):
        teaching.take(jog.robot.state().joints)
    jog.step((0.004, 0, 0))
    assert teaching.take(jog.robot.state().joints) == "003"


def test_views_are_added_after_those_that_a_person_wrote(jog, session, tmp_path):
    path = tmp_path / "mine.yaml"
    orbit = "{kind: orbit, target: [0.4, 0, 0.14], distance: 0.4, elevation_deg: 50, count: 3}"
    path.write_text(
        f"format: koala-trajectory\nversion: 1\nname: mine\nviews:\n  - {orbit}\n"
        "object: {centre: [0.4, 0, 0.1], size: [0.2, 0.2, 0.2]}\n"
    )
    assert Teaching(path, session, jog.obstacles).take(jog.robot.state().joints) == "003"
    found = load_trajectory(path)
    assert [group.kind for group in found.views] == ["orbit", "joints"] and found.object.size == (0.2, 0.2, 0.2)


def test_what_cannot_take_views_is_refused_at_once(session, tmp_path):
    obstacles = Obstacles.of(session, CARRIER)
    with pytest.raises(UsageError, match=r"name of a trajectory file.*\.yaml"):
        Teaching(tmp_path / "views.txt", session, obstacles)
    path = tmp_path / "split.yaml"
    path.write_text(
        "format: koala-trajectory\nversion: 1\nname: s\nsplit: {train: 2, test: 1}\nviews:\n"
        "  - {kind: orbit, target: [0.4, 0, 0.14], distance: 0.4, count: 3}\n"
    )
    with pytest.raises(UsageError, match="has a split"):
        Teaching(path, session, obstacles)


def test_a_pose_that_could_not_be_planned_is_not_taken(session, tmp_path):
    teaching = Teaching(tmp_path / "views.yaml", session, Obstacles.of(session, CARRIER))
    into_the_table = np.radians([0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(UnreachableError, match="cannot be a view"):
        teaching.take(into_the_table)
    assert not Path(teaching.path).exists()
