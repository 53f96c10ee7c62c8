"""Patterns of views: where the cameras are and what they look at."""

import numpy as np
import pytest
from pydantic import ValidationError

from koala3d.capture.model.viewpoints import (
    CameraPose,
    GridViews,
    HemisphereViews,
    JointViews,
    OrbitViews,
    PoseViews,
    TiltedViews,
    spread,
)

TARGET = (0.4, 0.1, 0.2)


def _miss(view, target):
    """Distance [m] at which the optical axis passes `target`, and the distance [m] to it along the axis."""
    in_camera = np.linalg.inv(view.camera_pose(np.eye(4))) @ np.append(target, 1.0)
    return np.linalg.norm(in_camera[:2]), in_camera[2]


@pytest.mark.parametrize(
    "group",
    [
        HemisphereViews(kind="hemisphere", target=TARGET, distance=0.4, count=37, rings=5),
        HemisphereViews(kind="hemisphere", target=TARGET, distance=0.4, count=4, rings=4, elevation_deg=(0, 89)),
        OrbitViews(kind="orbit", target=TARGET, distance=0.4, count=9),
    ],
)
def test_cameras_look_at_the_target_from_their_distance(group):
    views = group.generate()
    assert len(views) == group.number
    for view in views:
        miss, distance = _miss(view, TARGET)
        assert miss < 1e-12 and distance == pytest.approx(0.4)


def test_a_hemisphere_covers_its_range_evenly():
    group = HemisphereViews(kind="hemisphere", target=TARGET, distance=0.4, count=50, rings=4, elevation_deg=(20, 70))
    offset = np.array([view.camera_pose(np.eye(4))[:3, 3] for view in group.generate()]) - TARGET
    elevation = np.degrees(np.arcsin(offset[:, 2] / 0.4))
    assert elevation.min() == pytest.approx(20) and elevation.max() == pytest.approx(70)
    apart = np.linalg.norm(offset[:, None] - offset[None], axis=-1) + 9 * np.eye(50)
    assert 0.08 < apart.min(axis=1).min() and apart.min(axis=1).max() < 0.16  # a hexagon pattern would give about 0.13
    assert np.linalg.norm(np.diff(offset, axis=0), axis=1).max() < 0.25  # walked to and fro, never back to a start


@pytest.mark.parametrize(
    "group",
    [
        HemisphereViews(kind="hemisphere", target=TARGET, distance=0.4, count=12, rings=3),
        OrbitViews(kind="orbit", target=TARGET, distance=0.4, count=5),
        TiltedViews(kind="tilted", target=TARGET, count=9, turn_deg=(0, 0)),
        PoseViews(kind="poses", poses=[CameraPose(position=(0, 0, 0.2), look_at=TARGET)]),
        GridViews(kind="grid", target=TARGET, centre=TARGET, size=(0.5, 0.3), columns=2, rows=2),
    ],
)
def test_an_arm_that_hangs_sees_the_same_upright_from_the_other_side_of_the_base(group):
    """Its base is turned about x by half a turn: there y and z point the other way, and so do azimuths."""
    for standing, hanging in zip(group.generate(), group.generate(up=-1), strict=True):
        above, below = (np.subtract(view.camera_pose(np.eye(4))[:3, 3], TARGET) for view in (standing, hanging))
        moves = not isinstance(group, GridViews | PoseViews)  # which name their places
        np.testing.assert_allclose(below, above * [1, 1, -1 if moves else 1], atol=1e-12)
        assert standing.camera_pose(np.eye(4))[2, 1] < 0 < hanging.camera_pose(np.eye(4))[2, 1]  # the picture's downward axis
        assert hanging.camera_pose(np.eye(4))[2, 0] == pytest.approx(0)  # and it is level


def test_a_grid_is_level():
    views = GridViews(kind="grid", target=TARGET, centre=(0.4, 0, 0.5), size=(0.2, 0.1), columns=3, rows=2).generate()
    positions = np.array([view.camera_pose(np.eye(4))[:3, 3] for view in views])
    np.testing.assert_allclose(positions[:, 2], 0.5)
    np.testing.assert_allclose([positions.min(0), positions.max(0)], [[0.3, -0.05, 0.5], [0.5, 0.05, 0.5]], atol=1e-12)


def test_tilted_views_vary_everything_inside_the_ranges():
    group = TiltedViews(kind="tilted", target=TARGET, distance=(0.3, 0.5), tilt_deg=(5, 40), shift=(0.04, 0.03), count=40)
    tilts, turns, misses = [], [], []
    for view in group.generate():
        forward = view.camera_pose(np.eye(4))[:3, 2]
        tilts.append(np.degrees(np.arccos(-forward[2])))
        turns.append(np.degrees(np.arctan2(*view.camera_pose(np.eye(4))[1::-1, 0])))
        hit = view.camera_pose(np.eye(4))[:3, 3] + forward * (TARGET[2] - view.camera_pose(np.eye(4))[2, 3]) / forward[2]
        misses.append(np.abs(hit - TARGET)[:2])
        assert 0.3 - 1e-9 <= np.linalg.norm(hit - view.camera_pose(np.eye(4))[:3, 3]) <= 0.5 + 1e-9
    assert min(tilts) >= 5 - 1e-6 and max(tilts) <= 40 + 1e-6 and np.ptp(tilts) > 25
    assert np.max(misses, axis=0) == pytest.approx([0.04, 0.03], rel=0.2) and np.ptp(turns) > 300


def test_listed_poses_and_joints():
    by_point = CameraPose(position=(0.4, 0.1, 0.7), look_at=TARGET)
    turned = CameraPose(position=(0, 0, 1), quaternion_wxyz=(0, 2, 0, 0))
    views = PoseViews(kind="poses", poses=[by_point, turned], roll_deg=[0, 90]).generate()
    assert _miss(views[0], TARGET) == (pytest.approx(0), pytest.approx(0.5))
    np.testing.assert_allclose(views[1].camera_pose(np.eye(4))[:3, :3], np.diag([1, -1, -1]), atol=1e-12)
    np.testing.assert_allclose(views[1].rolls, [0, np.pi / 2])
    (view,) = JointViews(kind="joints", joints_deg=[(0, -90, 90, 0, 0, 180)]).generate()
    assert view.joints is not None and view.base_from_camera is None
    np.testing.assert_allclose(view.joints, np.radians([0, -90, 90, 0, 0, 180]))


@pytest.mark.parametrize(
    "wrong",
    [{}, {"look_at": (0, 0, 0), "quaternion_wxyz": (1, 0, 0, 0)}, {"look_at": (0, 0, 1)}, {"quaternion_wxyz": (0, 0, 0, 0)}],
)
def test_a_pose_has_one_orientation(wrong):
    with pytest.raises(ValidationError):
        CameraPose(position=(0, 0, 1), **wrong)


@pytest.mark.parametrize(("count", "chosen"), [(50, 10), (10, 0), (7, 3), (1, 1)])
def test_spread_is_even(count, chosen):
    indices = sorted(spread(count, chosen))
    assert len(indices) == chosen and all(0 <= index < count for index in indices)
    assert chosen < 2 or np.ptp(np.diff(indices)) <= 1
