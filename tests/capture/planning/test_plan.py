"""Plans reach every view without a collision, and name the views that cannot be taken."""

from dataclasses import replace

import numpy as np
import pytest

from koala3d.capture.drivers.errors import PlanningError, UnreachableError
from koala3d.capture.model.kinematics import JOINT_LIMIT, forward
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.shapes.geometry import Box
from koala3d.capture.model.trajectory import Trajectory, load_trajectory
from koala3d.capture.model.viewpoints import HemisphereViews, JointViews
from koala3d.capture.planning import Obstacles, connect, plan

MOUNT = RigDescription().carrier()


def _orbit(**changes):
    view = {"kind": "orbit", "target": (0.4, 0, 0.14), "distance": 0.4, "count": 6, "elevation_deg": 40, **changes}
    return Trajectory.model_validate({"name": "orbit", "views": [view]})


SAME = pytest.param("koala", marks=pytest.mark.slow)
"""Its views are those of koala_demo."""


@pytest.mark.parametrize(
    "name", ["koala_demo", "koala_fine", "koala_metre", "koala_hanging", SAME, "calibration_demo", "calibration_hanging"]
)
def test_shipped_trajectories_are_reachable(name):
    trajectory = load_trajectory(name)
    planned, obstacles = plan(trajectory, MOUNT), Obstacles.of(trajectory, MOUNT)
    assert len(planned) == len(trajectory.viewpoints())
    here, ways = planned[0].joints, []
    for view, asked in zip(planned, trajectory.viewpoints(), strict=True):
        reached = forward(view.joints) @ MOUNT.flange_from_camera
        np.testing.assert_allclose(reached, view.viewpoint.camera_pose(MOUNT), atol=2e-6)
        np.testing.assert_allclose(reached[:3, 2:], asked.camera_pose(MOUNT)[:3, 2:], atol=2e-6)  # rolled at most
        assert np.abs(view.joints).max() < JOINT_LIMIT and obstacles.sight(view.joints[None])[0] >= 0
        for there in view.path:
            ways.append(np.linspace(here, there, 100))
            here = there
        assert (here == view.joints).all()
    assert obstacles.margin(np.concatenate(ways)).min() >= 0
    assert MOUNT.wound(np.concatenate(ways)).max() <= 0.5


@pytest.mark.parametrize(("name", "distance_m"), [("koala_demo", 0.4), ("koala_hanging", 1.0)])
def test_the_object_is_seen_from_all_sides(name, distance_m):
    trajectory = load_trajectory(name)
    group = trajectory.views[0]
    assert isinstance(group, HemisphereViews)
    offset = np.array([view.camera_pose(MOUNT)[:3, 3] for view in trajectory.viewpoints()]) - group.target
    azimuth = np.sort(np.degrees(np.arctan2(offset[:, 1], offset[:, 0])))
    assert np.diff(azimuth, append=azimuth[0] + 360).max() < 30
    assert np.linalg.norm(offset, axis=1) == pytest.approx(distance_m)


def test_the_limit_of_the_cable_changes_no_picture():
    """The arm comes to some views another way round, and no picture is rolled otherwise."""
    trajectory, free = load_trajectory("koala_demo"), replace(MOUNT, cable=None)
    held, loose = plan(trajectory, MOUNT), plan(trajectory, free)
    assert replace(free, cable=MOUNT.cable).wound(np.stack([view.joints for view in loose])).max() > 0.8, "the premise"
    for one, other in zip(held, loose, strict=True):
        np.testing.assert_allclose(one.viewpoint.camera_pose(MOUNT), other.viewpoint.camera_pose(free), atol=1e-9)


@pytest.mark.parametrize("name", ["koala_demo", "koala_hanging"])
def test_an_arm_as_built_takes_the_same_pictures_in_nearly_the_same_way(name: str):
    """What a person has looked at with the nominal links is what the arm does, brought onto the poses by its own links."""
    trajectory = load_trajectory(name)
    built = MOUNT.as_built(MOUNT.arm.links.calibrated(np.random.default_rng(0), 5e-4, 1e-3))
    nominal, planned = plan(trajectory, MOUNT), plan(trajectory, built)
    obstacles, here, ways, elsewhere = Obstacles.of(trajectory, built), planned[0].joints, [], 0
    for one, other in zip(nominal, planned, strict=True):
        np.testing.assert_allclose(one.viewpoint.camera_pose(MOUNT), other.viewpoint.camera_pose(built), atol=1e-9)
        np.testing.assert_allclose(built.base_from_camera(other.joints), other.viewpoint.camera_pose(built), atol=1e-6)
        if np.abs(one.joints - other.joints).max() > 0.1:  # only where the arm as it is would be too close
            near = built.built.near(built.flange_for(one.viewpoint.camera_pose(MOUNT)), one.joints)
            assert not obstacles.free(near)[0]
            elsewhere += 1
        for there in other.path:
            ways.append(np.linspace(here, there, 100))
            here = there
    assert obstacles.margin(np.concatenate(ways)).min() >= 0 and elsewhere <= 1


def test_a_view_that_would_wind_up_the_cable_is_named_with_the_limit():
    views = [JointViews(kind="joints", joints_deg=[(0, -90, 90, -90, -90, 0), (0, -90, 90, -90, -90, 300)])]
    with pytest.raises(UnreachableError, match=r"1 of 2 views.*001: the camera's cable.*0\.83 turns, limit 0\.5 .robot\.cable"):
        plan(Trajectory(name="wound", views=views), MOUNT)


def test_the_same_trajectory_gives_the_same_plan():
    first, second = plan(_orbit(), MOUNT), plan(_orbit(), MOUNT)
    assert all((a.joints == b.joints).all() for a, b in zip(first, second, strict=True))


def test_views_out_of_reach_are_named_with_their_reason():
    with pytest.raises(UnreachableError) as caught:
        plan(_orbit(target=(0.75, 0, 0.14), elevation_deg=10), MOUNT)
    message = str(caught.value)
    assert "of 6 views cannot be taken" in message and "out of reach, wrist" in message and caught.value.exit_code == 2


def test_views_inside_the_table_or_the_object_are_named():
    with pytest.raises(UnreachableError, match="to table too close"):
        plan(_orbit(elevation_deg=1, target=(0.4, 0, 0.01)), MOUNT)
    volume = Box(centre=(0.4, 0, 0.3), size=(0.7, 0.7, 0.6))
    with pytest.raises(UnreachableError, match="to object too close"):
        plan(Trajectory(name="boxed", views=_orbit().views, object=volume), MOUNT)


def test_views_that_the_arm_hides_are_named():
    volume = Box(centre=(0.6, 0, 0.15), size=(0.26, 0.26, 0.3))
    across_the_base = {"target": (0.6, 0, 0.14), "distance": 1.0, "elevation_deg": 5, "azimuth_deg": (175, 185), "count": 1}
    with pytest.raises(UnreachableError, match=r"000: .* hides the object from the camera"):
        plan(Trajectory(name="hidden", views=_orbit(**across_the_base).views, object=volume), MOUNT)
    assert plan(_orbit(**across_the_base), MOUNT)  # where no object is named, nothing is hidden


def test_joint_views_are_kept_and_checked():
    degrees: list[tuple[float, float, float, float, float, float]] = [(0, -90, 90, -90, -90, 0), (20, -90, 90, -90, -90, 10)]
    planned = plan(Trajectory(name="joints", views=[JointViews(kind="joints", joints_deg=degrees)]), MOUNT)
    np.testing.assert_allclose([view.joints for view in planned], np.radians(degrees))
    assert planned[0].viewpoint.base_from_camera is not None
    with pytest.raises(UnreachableError, match="joint 6 at 400 degrees, limit 360"):
        plan(Trajectory(name="joints", views=[JointViews(kind="joints", joints_deg=[(0, -90, 90, -90, -90, 400)])]), MOUNT)


def test_an_arm_that_starts_in_the_table_is_an_error():
    stuck = np.array([0, 0.3, 0, -np.pi / 2, 0, 0])
    obstacles = Obstacles(MOUNT, 0.02, table_z=0.0)
    with pytest.raises(PlanningError, match="already too close"):
        connect(stuck, np.add(stuck, [0, 0.1, 0, 0, 0, 0]), obstacles)
