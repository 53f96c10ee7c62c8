"""What the page of a session shows, asked of its handles."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.page.session import CaptureView, along_z
from koala3d.capture.page.timeline import Timeline, of_trajectory
from koala3d.datasets import pose
from koala3d.datasets.page import open_page

MOUNT = RigDescription().carrier()


@pytest.fixture(scope="module")
def session() -> tuple[Trajectory, Timeline]:
    views = [{"kind": "orbit", "target": [0.4, 0.0, 0.14], "distance": 0.4, "elevation_deg": 40, "count": 4}]
    views[0]["roll_deg"] = [0, 90, 180, 270]
    trajectory = Trajectory.model_validate({"name": "ring", "views": views, "split": {"train": 3, "test": 1}})
    return trajectory, of_trajectory(trajectory, MOUNT)


@pytest.fixture
def shown(session: tuple[Trajectory, Timeline]) -> Iterator[CaptureView]:
    with open_page("session", 0) as page:
        yield CaptureView(page, session[0], MOUNT, session[1])


@pytest.mark.parametrize("direction", [(0, 0, 2), (0, 0, -1), (1, 0, 0), (0.3, -0.2, 0.9)])
def test_z_is_turned_along_a_direction(direction: tuple[float, float, float]) -> None:
    rotation = along_z(np.array(direction, float))[:3, :3]
    np.testing.assert_allclose(rotation[:, 2], np.array(direction) / np.linalg.norm(direction), atol=1e-12)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_no_direction_turns_nothing() -> None:
    np.testing.assert_array_equal(along_z(np.zeros(3)), np.eye(4))


def test_the_arm_is_drawn_where_its_capsules_are(shown: CaptureView, session: tuple[Trajectory, Timeline]) -> None:
    middle = session[1].end / 2
    shown.go(middle)
    ends = MOUNT.segments(session[1].at(middle))
    for part, handle in zip(MOUNT.shape.parts, shown._parts, strict=True):
        start, end = ends[MOUNT.shape.index[part.name]]
        np.testing.assert_allclose(handle.position, start, atol=1e-9)
        turned = pose.from_quaternion(tuple(handle.wxyz), (0, 0, 0))[:3, 2]
        np.testing.assert_allclose(turned, (end - start) / np.linalg.norm(end - start), atol=1e-6)


def test_the_text_names_the_next_view_and_the_closest_pair(shown: CaptureView, session: tuple[Trajectory, Timeline]) -> None:
    shown.go(0.0)
    assert f"0.0 of {session[1].end:.1f} s, view 000" in shown._angles.content and "closest: " in shown._angles.content
    shown.go(session[1].end + 1)
    assert "view none" in shown._angles.content


def test_a_taken_view_keeps_its_planned_time(shown: CaptureView, session: tuple[Trajectory, Timeline]) -> None:
    stop = session[1].stops[1]
    shown.taken(replace(stop, seconds=99.0, measured="exposed for 10 ms"))
    assert shown.stops[stop.name].seconds == stop.seconds and shown.stops[stop.name].measured == "exposed for 10 ms"


def test_every_view_has_a_camera_that_leads_to_it(shown: CaptureView, session: tuple[Trajectory, Timeline]) -> None:
    assert set(shown.frusta) == {stop.name for stop in session[1].stops} == {"000", "001", "002", "003"}
    stop = session[1].stops[2]
    np.testing.assert_allclose(shown.frusta[stop.name].position, stop.base_from_camera[:3, 3], atol=1e-9)
    shown._chosen(None, stop)
    assert shown.slider.value == pytest.approx(stop.seconds)
