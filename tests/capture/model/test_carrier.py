"""An arm with its camera: collisions and limits in cases made by hand."""

import itertools

import numpy as np
import pytest
import trimesh

from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.carrier import Beside, Cable, CameraCapsule, Carrier
from koala3d.capture.model.shapes.solids import BoxSolid, CylinderSolid, MeshSolid
from koala3d.capture.model.viewpoints import Viewpoint
from koala3d.capture.planning import Obstacles, connect
from koala3d.capture.planning.solutions import solve
from koala3d.datasets import pose

MOUNT = pose.from_rotation_vector([np.radians(45), 0, 0], [0, 0.06, 0.08])
STRETCHED = np.radians([0, 0, 0, -90, 0, 0])  # along the base's -x axis, 0.2 m high and farther out than 0.8 m
UPRIGHT = load_arm("ur5e").home


def carrier(arm: str = "ur5e", **others) -> Carrier:
    return Carrier(load_arm(arm), MOUNT, **others)


@pytest.mark.parametrize(
    ("arm", "length"),
    [("ur3e", 0.457), ("ur5e", 0.817), ("ur10e", 1.184), ("ur16e", 0.838), ("ur15", 1.164), ("ur20", 1.591), ("ur30", 1.141)],
)
def test_each_arm_is_as_long_as_it_is(arm: str, length: float) -> None:
    """A wall just beyond the end of the forearm is free; one that is nearer is not. The maker states these lengths."""
    one = carrier(arm)
    forearm = one.segments(STRETCHED)[one.shape.index["forearm"], 1]
    assert -forearm[0] == pytest.approx(length, abs=1e-3)
    radius = one.shape.radii[one.shape.index["forearm"]]
    for gap, free in ((0.01, True), (-0.01, False)):
        x = -length - radius - 0.02 - gap
        wall = BoxSolid(kind="box", name="wall", size=(0.2, 0.01, 0.2), pose={"position": [x - 0.1, forearm[1], forearm[2]]})
        margin = Obstacles(carrier(arm, solids=(wall,)), 0.02).margins(STRETCHED[None])["forearm to wall"][0]
        assert (margin > 0) == free and margin == pytest.approx(gap, abs=2e-3)


def test_what_is_free_for_one_arm_is_not_for_a_longer_one() -> None:
    lamp = CylinderSolid(kind="cylinder", name="lamp", radius=0.05, height=2.0, pose={"position": [-1.0, -0.04, 1.0]})
    short, long = (Obstacles(carrier(arm, solids=(lamp,)), 0.02) for arm in ("ur5e", "ur10e"))
    assert short.free(STRETCHED[None])[0] and not long.free(STRETCHED[None])[0]
    pair, room = long.nearest(STRETCHED)
    assert pair == "forearm to lamp" and room < -0.05


def test_a_path_goes_around_a_pillar(tmp_path) -> None:
    """The same pillar as a cylinder and as a mesh: straight through is blocked, and the path that is found keeps clear."""
    trimesh.creation.cylinder(0.04, 1.5).export(tmp_path / "pillar.stl")
    place = {"position": [-0.45, -0.45, 0.75]}
    start, goal = np.radians([10, -30, 30, -90, -90, 0]), np.radians([80, -30, 30, -90, -90, 0])
    for solid in (
        CylinderSolid(kind="cylinder", name="pillar", radius=0.04, height=1.5, pose=place),
        MeshSolid(kind="mesh", name="pillar", file=str(tmp_path / "pillar.stl"), pose=place),
    ):
        obstacles = Obstacles(carrier(solids=(solid,)), 0.02)
        assert obstacles.free(np.stack([start, goal])).all() and not obstacles.free(np.linspace(start, goal, 100)).all(), (
            "the premise"
        )
        path = [start, *connect(start, goal, obstacles)]
        assert len(path) > 2
        for one, other in itertools.pairwise(path):
            assert obstacles.free(np.linspace(one, other, 100)).all()


@pytest.mark.parametrize("part", ["base", "shoulder", "upper arm", "elbow", "forearm", "wrist 1", "wrist 2"])
def test_a_camera_that_reaches_into_a_link_hits_it(part: str) -> None:
    """A rod from the camera to the middle of a link, and one of half that length, against many points of both."""
    joints, plain = np.radians([0, -90, 90, -60, -60, 0]), carrier(body=())
    camera_from_base = pose.inverse(plain.base_from_camera(joints))
    index, share = plain.shape.index[part], np.linspace(0, 1, 300)[:, None]
    ends = plain.segments(joints)[index] @ camera_from_base[:3, :3].T + camera_from_base[:3, 3]
    link = ends[0] * (1 - share) + ends[1] * share
    for length in (1.0, 0.5):
        end = length * ends.mean(axis=0)
        rod = CameraCapsule(name="rod", start=(0, 0, 0), end=tuple(end), radius=0.002)
        found = Obstacles(carrier(body=(rod,)), 0.0).margins(joints[None])[f"rod to {part}"][0]
        slow = np.linalg.norm((share * end)[:, None] - link, axis=-1).min() - 0.002 - plain.shape.radii[index]
        assert found == pytest.approx(slow, abs=0.003) and (found < 0 or length < 1)
    assert Obstacles(plain, 0.0).margin(joints[None])[0] > 0, "the premise: without the rod it is free"


def test_the_cable_limits_the_turns_of_its_joints() -> None:
    """By default the first and the last joint: each by half a turn to either side. The others bend the cable."""
    cable = Cable()
    angles = np.radians([[0, 300, 300, 300, 300, 180.0], [-198, 0, 0, 0, 0, 90], [90, 0, 0, 0, 0, -270]])
    np.testing.assert_allclose(cable.turns(angles), [0.5, 0.55, 0.75])
    assert carrier(cable=cable).permitted(angles - 1e-9).tolist() == [True, False, False]
    both = Cable(joints=[5, 6], rest_deg=[-90, 0])
    assert both.turns(np.radians([300, 0, 0, 0, -90, 0.0])) == 0 and both.turns(np.radians([0, 0, 0, 0, 90, -90.0])) == 0.5


def test_a_view_that_would_wind_up_the_cable_is_refused_with_the_turns() -> None:
    given = Viewpoint(joints=np.radians([0, -90, 90, -90, -90, 300.0]), name="000")
    assert not solve(given, Obstacles(carrier(), 0.02)).reason
    reason = solve(given, Obstacles(carrier(cable=Cable(max_turns=0.75)), 0.02)).reason
    assert reason == "the camera's cable would be wound up by 0.83 turns, limit 0.75 (robot.cable in the rig file)"


def test_the_planner_takes_the_turn_that_does_not_wind_up_the_cable() -> None:
    wanted = Viewpoint(pose.look_at((0.15, 0.1, 0.5), (0.4, 0.0, 0.14)), (0.0, np.pi / 2, np.pi), name="000")
    free, limited = (solve(wanted, Obstacles(carrier(cable=cable), 0.02, table_z=0.0)) for cable in (None, Cable(max_turns=0.5)))
    assert np.abs(free.joints[:, 5]).max() > np.pi, "the premise: without a limit the last joint turns further"
    assert 0 < len(limited.joints) < len(free.joints) and np.abs(limited.joints[:, 5]).max() <= np.pi
    tight = solve(wanted, Obstacles(carrier(cable=Cable(max_turns=0.003)), 0.02, table_z=0.0))
    assert not len(tight.joints) and "cable would be wound up" in tight.reason and "limit 0.003" in tight.reason


def test_a_path_never_winds_up_the_cable_beyond_its_limit() -> None:
    limited = Obstacles(carrier(cable=Cable(max_turns=0.5)), 0.02)
    start, goal = np.radians([0, -90, 60, -90, -90, -170]), np.radians([40, -90, 60, -90, -90, 170])
    for one, other in zip([start, *connect(start, goal, limited)], connect(start, goal, limited), strict=False):
        assert limited.carrier.permitted(np.linspace(one, other, 100)).all()
    assert not limited.free(np.radians([[0, -90, 60, -90, -90, 200.0]]))[0]


def test_an_arm_whose_cable_is_wound_too_far_may_unwind_it() -> None:
    limited = Obstacles(carrier(cable=Cable(max_turns=0.5)), 0.02)
    start, goal = np.radians([0, -90, 60, -90, -90, 230]), np.radians([40, -90, 60, -90, -90, 170])
    assert not limited.free(start[None])[0] and len(connect(start, goal, limited)) == 1


def test_every_row_of_a_plate_counts() -> None:
    """The plate of a target is several capsules of one name: a ball at its first row and one at its last are both near."""
    place = Beside(np.eye(4), pose.rigid(np.eye(3), [0.0, 0.0, 0.05]), (0.2, 0.2))
    joints = np.radians([0, -90, 90, -90, -90, 0])
    alone = carrier(beside=place)
    ends = alone.segments(joints)[[part.name == "target" for part in alone.shape.parts]]
    for row in (ends[0], ends[-1]):
        ball = CylinderSolid(kind="cylinder", name="ball", radius=0.01, height=0.02, pose={"position": tuple(row.mean(axis=0))})
        assert Obstacles(carrier(beside=place, solids=(ball,)), 0.0).margins(joints[None])["target to ball"][0] < 0


def test_limits_of_joints_are_those_of_the_model() -> None:
    panda = carrier("panda")
    beyond = panda.arm.home.copy()
    beyond[3] = 0.1
    assert panda.forbidden(panda.arm.home) == "" and panda.forbidden(beyond) == "joint 4 at 6 degrees, limit -4"
    assert not Obstacles(panda, 0.02).free(beyond[None])[0] and Obstacles(panda, 0.02).free(panda.arm.home[None])[0]
    assert solve(Viewpoint(joints=np.zeros(6)), Obstacles(panda, 0.02)).reason.startswith("6 joint angles for the Franka Panda")


@pytest.mark.parametrize("arm", ["ur3e", "ur5e", "ur7e", "ur10e", "ur15", "ur16e", "ur20", "ur30", "panda"])
def test_every_arm_is_free_at_home(arm: str) -> None:
    one = carrier(arm)
    for home in (one.arm.home, one.arm.hanging_home):
        pair, room = Obstacles(one, 0.02).nearest(home)
        assert room > 0, pair
    assert one.arm.inside(one.arm.home) and np.linalg.norm(one.arm.forward(one.arm.home)[:3, 3]) > 0.2
