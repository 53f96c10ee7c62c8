"""Plans are made for the arm as it is: its links come from the controller, or from the copy beside the rig file."""

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.cli import main
from koala3d.capture.drivers.errors import UnreachableError
from koala3d.capture.model.rig import RigDescription, load_rig, recorded_carrier
from koala3d.capture.model.shapes.solids import BoxSolid
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.model.viewpoints import JointViews
from koala3d.capture.planning import plan
from koala3d.capture.rig.controllers import write_simulated_rig
from koala3d.capture.rig.links import reported_links
from koala3d.capture.rig.opening import open_rig
from koala3d.capture.sim.controller.process import SimulatedController
from koala3d.datasets import pose
from koala3d.datasets.core.errors import UsageError

DEGREES = (-20.0, -80.0, 80.0, -90.0, -90.0, 30.0)
JOINTS = np.radians(DEGREES)
RIG = RigDescription()


@pytest.fixture(scope="module")
def crooked() -> Iterator[SimulatedController]:
    """An arm whose links are off by several millimetres; it stands at `JOINTS`."""
    errors = {"length_error_mm": 3.0, "angle_error_deg": 0.15}
    with SimulatedController.start(seed=6, time_scale=50.0, home=JOINTS, repeatability_mm=0.0, **errors) as controller:
        yield controller


def test_the_clearance_is_that_of_the_arm_as_it_is(crooked: SimulatedController) -> None:
    """A wall just beyond the clearance of the camera by the nominal links, and within it where the camera really is."""
    links = reported_links(RIG, crooked.host)
    nominal, built = RIG.carrier(), RIG.carrier().as_built(links)
    true = crooked.true_base_from_flange()
    np.testing.assert_allclose(built.forward(JOINTS), true, atol=2e-4)  # one stop, to the repeatability of its orientation
    off = true[:3, 3] - nominal.forward(JOINTS)[:3, 3]
    assert np.linalg.norm(off) > 4e-3, "the premise"

    part = nominal.shape.index["camera"]
    axis = int(np.abs(off).argmax())
    sign = np.sign(off[axis])
    reach = nominal.segments(JOINTS)[part, :, axis] * sign + nominal.shape.radii[part]
    there = (true @ pose.inverse(nominal.forward(JOINTS)) @ np.c_[nominal.segments(JOINTS)[part], [1, 1]].T)[axis] * sign
    assert (there + nominal.shape.radii[part]).max() > reach.max() + 2e-3, "the premise: the camera really reaches farther"
    place = np.zeros(3)
    place[axis] = sign * (reach.max() + 0.02 + 1e-3 + 0.5)
    place += nominal.segments(JOINTS)[part].mean(axis=0) * (np.arange(3) != axis)
    size = np.where(np.arange(3) == axis, 1.0, 0.01)
    wall = BoxSolid(kind="box", name="wall", size=tuple(size), pose={"position": tuple(place)})
    rig = RIG.model_copy(update={"obstacles": [wall]})
    view = Trajectory(name="near", views=[JointViews(kind="joints", joints_deg=[DEGREES])], safety={"table_z": None})
    assert plan(view, rig.carrier()), "by the nominal links it is far enough"
    with pytest.raises(UnreachableError, match="to wall too close"):
        plan(view, rig.carrier().as_built(links))


def test_an_arm_that_says_no_links_is_planned_with_the_nominal_ones_and_that_is_said(
    crooked: SimulatedController, caplog: pytest.LogCaptureFixture
) -> None:
    crooked.ask("install", primary=False)
    try:
        assert reported_links(RIG, crooked.host) is None
    finally:
        crooked.ask("install", primary=True)
    assert "does not say its calibrated links: plans use the nominal ones of the UR5e" in caplog.text
    other = RigDescription.model_validate({"robot": {"model": "ur3e"}})
    with pytest.raises(UsageError, match="not those of a UR3e"):
        reported_links(other, crooked.host)


def test_a_session_takes_its_views_where_they_are_planned(tmp_path: Path) -> None:
    """The simulated arm differs from its model by millimetres: with its own links the flange comes where the plan wants it."""
    views = [
        {"kind": "orbit", "target": [0.4, 0, 0.14], "distance": 0.4, "count": 2, "elevation_deg": 40, "azimuth_deg": [90, 120]}
    ]
    small = {"width": 48, "height": 48, "binning": 4}
    trajectory = Trajectory.model_validate({"name": "two", "views": views, "camera": small})
    from koala3d.capture.recording.recorder import record

    with open_rig("sim", trajectory, scene="grey_card", seed=3, time_scale=50.0) as rig:
        recording = record(trajectory, rig, tmp_path / "rec")
        carrier = rig.carrier
    assert carrier.built is not None
    planned = plan(trajectory, carrier)
    for frame, view in zip(recording.frames, planned, strict=True):
        wanted = carrier.flange_for(view.viewpoint.camera_pose(carrier))
        assert pose.difference(frame.base_from_flange, wanted)[0] < 2e-4
        assert pose.difference(carrier.arm.forward(frame.joints), wanted)[0] > 5e-4, "the premise"
    kept = recorded_carrier(recording)
    np.testing.assert_allclose(kept.forward(JOINTS), carrier.forward(JOINTS), atol=1e-9)


def test_the_doctor_keeps_the_links_and_the_plan_uses_them(run_inside, tmp_path: Path) -> None:
    capture = partial(run_inside, main, "capture")
    with SimulatedController.as_built(seed=2, time_scale=50.0) as controller:
        write_simulated_rig(tmp_path / "my.yaml", controller, "board", 2)
        before = capture("plan", "calibration", "--rig", tmp_path / "my.yaml")
        assert before.returncode == 0 and "links of the arm: nominal, of the UR5e" in before.stdout
        examined = capture("doctor", "--rig", tmp_path / "my.yaml", "--seconds", "0.2")
        assert f"kept in {tmp_path / 'my.links.json'}" in examined.stdout
        reported = reported_links(load_rig(tmp_path / "my.yaml"), controller.host)
    after = capture("plan", "calibration", "--rig", tmp_path / "my.yaml")
    assert after.returncode == 0 and f"links of the arm: {tmp_path / 'my.links.json'}" in after.stdout
    content = json.loads((tmp_path / "my.links.json").read_text())
    assert reported is not None and content["links"] == reported.to_json()
    (tmp_path / "my.links.json").write_text("{}")
    refused = capture("plan", "calibration", "--rig", tmp_path / "my.yaml")
    assert refused.returncode == 2 and "my.links.json: is not a koala-links file" in refused.stderr


def test_a_real_arm_whose_payload_is_not_stated_is_not_moved(run_inside, tmp_path: Path) -> None:
    capture = partial(run_inside, main, "capture")
    done = capture("run", "calibration", "--rig", "ur5e_basler", "--out", tmp_path / "rec")
    assert done.returncode == 2 and "robot.installation.payload_kg is not stated" in done.stderr and "weigh camera" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1 and not (tmp_path / "rec").exists()
