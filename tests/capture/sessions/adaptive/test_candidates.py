import numpy as np
import pytest

from koala3d.capture.drivers.errors import UnreachableError
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.sessions.adaptive.candidates import dense, see
from koala3d.capture.sessions.adaptive.places import of_box
from koala3d.capture.sessions.adaptive.shape import eye_of
from koala3d.capture.sessions.adaptive.tour import far_apart, tour


def test_a_hemisphere_gets_denser_and_keeps_its_limits(trajectory):
    found = dense(trajectory, 120)
    assert 100 <= len(found) <= 140
    target, (low, high) = np.array(trajectory.views[0].target), trajectory.views[0].elevation_deg
    away = np.stack([view.base_from_camera[:3, 3] for view in found]) - target
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), trajectory.views[0].distance)
    elevations = np.degrees(np.arcsin(away[:, 2] / np.linalg.norm(away, axis=1)))
    assert elevations.min() == pytest.approx(low) and elevations.max() == pytest.approx(high)
    assert len(np.unique(elevations.round(3))) > trajectory.views[0].rings


def test_other_patterns_stay_as_they_are():
    listed = "views=[{kind: poses, poses: [{position: [0.1, 0, 0.4], look_at: [0.4, 0, 0.1]}]}]"
    found = dense(load_trajectory("koala_demo", overrides=[listed, "split=null"]))
    assert len(found) == 1 and found[0].base_from_camera[:3, 3].tolist() == [0.1, 0, 0.4]


def test_the_arm_can_take_every_candidate(candidates, obstacles, carrier):
    assert len(candidates) > 40
    for one in candidates:
        joints = one.solutions.joints
        assert (obstacles.margin(joints) >= 0).all()
        axes = carrier.base_from_camera(joints)[:, :3, 2]  # a roll leaves the axis
        np.testing.assert_allclose(axes, np.broadcast_to(one.base_from_camera[:3, 2], axes.shape), atol=1e-6)


def test_candidates_see_the_side_that_they_look_at(candidates, trajectory, obstacles, carrier):
    places = of_box(trajectory.object.corners, 1, 0.02)
    seen = see(candidates, places, obstacles, eye_of(carrier.flange_from_camera, None), None)
    for one, row in zip(candidates, seen.facing, strict=True):
        behind = (places.normals * -one.base_from_camera[:3, 2]).sum(1) < -0.5
        assert not row[behind].any() and (row > 0).any()


def test_the_first_views_are_far_apart_and_the_test_views_are_among_them(trajectory, carrier):
    stops, lost = tour(trajectory, carrier)
    assert lost == 0 and sum(one.use == "test" for one in stops) == 4 and sum(one.use == "train" for one in stops) == 10
    again, _ = tour(trajectory, carrier)
    assert all((a.joints == b.joints).all() for a, b in zip(stops, again, strict=True)), "a session is resumed in it"


def test_a_trajectory_out_of_reach_is_named(carrier):
    far = load_trajectory("koala_demo", overrides=["views.0.target=[3, 0, 0.14]", "views.0.count=4", "split=null"])
    with pytest.raises(UnreachableError, match="no training view can be taken"):
        tour(far, carrier)


def test_points_far_apart():
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [10, 0, 0]])
    assert far_apart(line, 3) == [0, 3, 2] and far_apart(line, 9) == [0, 3, 2, 1]
