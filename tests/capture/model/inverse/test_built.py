"""An arm with its own links: poses, shapes and inverse kinematics are those of the arm that was built."""

import numpy as np
import pytest

from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.built import BuiltArm
from koala3d.capture.model.rig import RigDescription
from koala3d.datasets import kinematics, pose
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.kinematics import Links

UR5E = load_arm("ur5e")
JOINTS = np.radians([[0, -90, 90, -60, -60, 0], [40, -70, 80, -120, -80, 30], [-130, -100, -80, -60, 70, 200]])


def calibrated(seed: int, length_m: float = 2e-3, angle_rad: float = 2e-3) -> Links:
    return UR5E.links.calibrated(np.random.default_rng(seed), length_m, angle_rad)


def far_away(tilt: float) -> Links:
    """A UR5e whose third axis is tilted against the second by `tilt` [rad], with the frames of the convention.

    Denavit-Hartenberg parameters of the axes at zero angles: x of each frame is the common normal of its axis and the one before.
    """
    frames = kinematics.link_frames(np.zeros(6), UR5E.links)
    axes, places = frames[:6, :3, 2].copy(), frames[:6, :3, 3]
    axes[2] = pose.from_rotation_vector([0, 0, tilt])[:3, :3] @ axes[2]
    before, found = np.eye(4), []
    for index in range(1, 6):
        z, origin, line, point = before[:3, 2], before[:3, 3], axes[index], places[index]
        x = np.cross(z, line)
        if np.linalg.norm(x) < 1e-9:  # parallel: through the origin of the frame before
            x = point - origin - z * (z @ (point - origin))
            foot = point - line * (line @ (point - origin))
        else:
            along = np.linalg.solve(np.stack([z, -line, x], axis=-1), point - origin)
            foot = point + line * along[1]
        x = x / np.linalg.norm(x)
        x = x if x @ (foot - origin) >= -1e-9 else -x
        after = pose.rigid(np.stack([x, np.cross(line, x), line], axis=-1), foot)
        step = pose.inverse(before) @ after
        theta, alpha = np.arctan2(step[1, 0], step[0, 0]), np.arctan2(step[2, 1], step[2, 2])
        found.append((step[2, 3], step[:3, 3] @ [np.cos(theta), np.sin(theta), 0], alpha, theta))
        before = after
    d, a, alpha, theta = np.array([*found, (0.0, 0.0, 0.0, 0.0)]).T
    return Links(d, a, alpha, theta, tool=pose.inverse(before) @ frames[-1])


@pytest.mark.parametrize("links", [calibrated(1), calibrated(2), far_away(4e-3)], ids=["one", "another", "far"])
def test_the_inverse_reaches_every_pose_with_as_many_branches_as_the_model(links: Links) -> None:
    arm = BuiltArm(UR5E, links)
    for joints in JOINTS:
        target = arm.forward(joints)
        found = arm.inverse(target)
        assert len(found) == len(UR5E.inverse(target)) >= 4
        assert np.abs(np.angle(np.exp(1j * (found - joints)))).max(axis=1).min() < 1e-9
        for one in found:
            np.testing.assert_allclose(arm.forward(one), target, atol=1e-8)
        assert pose.difference(UR5E.forward(joints), target)[0] > 1e-3, "the premise: the model's links lead elsewhere"


@pytest.mark.parametrize("links", [calibrated(4), far_away(1e-3), far_away(-3e-4)], ids=["near", "far", "farther"])
def test_the_shape_stays_at_the_links_wherever_the_convention_puts_their_frames(links: Links) -> None:
    arm = BuiltArm(UR5E, links)
    off, turned = pose.difference(arm.frames(JOINTS), UR5E.frames(JOINTS))
    assert off.max() < 0.02 and turned.max() < 0.02
    np.testing.assert_array_equal(arm.frames(JOINTS)[:, -1], arm.forward(JOINTS))
    axes = kinematics.link_frames(JOINTS, links)[:, :, :3, 2]
    np.testing.assert_allclose(arm.frames(JOINTS)[:, :-1, :3, 2], axes[:, :-1], atol=1e-9)


def test_the_premise_frames_of_nearly_parallel_axes_are_far_away() -> None:
    assert np.abs(far_away(-3e-4).d).max() > 100
    assert pose.difference(kinematics.forward(JOINTS, far_away(0.0)), UR5E.forward(JOINTS))[0].max() < 1e-9


def test_a_flange_turns_with_its_links() -> None:
    """Frames keep their places on links: each is moved by the joints before it only, as a rigid body."""
    arm = BuiltArm(UR5E, far_away(1e-3))
    one, other = arm.frames(JOINTS[0]), arm.frames(JOINTS[0] + np.eye(6)[3] * 0.7)
    np.testing.assert_allclose(one[:4], other[:4], atol=1e-9)
    assert pose.difference(one[4], other[4])[1] == pytest.approx(0.7)


def test_links_of_another_arm_are_refused() -> None:
    with pytest.raises(UsageError, match=r"not those of a UR5e.*flange is"):
        BuiltArm(UR5E, load_arm("ur3e").links)
    with pytest.raises(UsageError, match="7 joints"):
        BuiltArm(UR5E, load_arm("panda").links)


def test_a_carrier_has_poses_and_shape_of_the_arm_as_built() -> None:
    nominal = RigDescription().carrier()
    built = nominal.as_built(calibrated(5))
    target = built.base_from_camera(JOINTS[0])
    assert pose.difference(target, nominal.base_from_camera(JOINTS[0]))[0] > 1e-3
    assert np.abs(built.segments(JOINTS[0]) - nominal.segments(JOINTS[0])).max() > 1e-3
    np.testing.assert_allclose(
        built.base_from_camera(built.inverse(built.flange_for(target))), target[None].repeat(8, 0), atol=1e-8
    )
    assert built.as_built(None).built is None
