"""The simulated turntable: what turns, what stands still, and where the axis truly is."""

from dataclasses import replace

import numpy as np

from koala3d.capture.drivers.turntable.grbl import GrblTurntable
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.sim.camera import SimulatedCamera, StillArm
from koala3d.capture.sim.laboratory.renderer import Renderer
from koala3d.capture.sim.laboratory.scenes import STILL, stage
from koala3d.capture.sim.truth import RigTruth
from koala3d.capture.sim.turntable import GEAR_RAD, SimulatedTurntable, TurntableTruth
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.imaging import images
from koala3d.datasets.turntable import Axis

RIG = RigDescription.model_validate({"turntable": {"base_from_turntable": {"position": [0.45, 0.05, 0.0]}}})


def test_the_true_axis_differs_from_the_nominal_one_and_depends_on_the_seed():
    truths = [TurntableTruth.draw(RIG.turntable, seed) for seed in range(40)]
    off = np.array([truth.axis.difference(RIG.turntable.axis) for truth in truths])
    assert 2e-3 < np.median(off[:, 0]) < 3e-3 and 0.25 < np.degrees(np.median(off[:, 1])) < 0.5
    assert np.array_equal(truths[3].axis.point, TurntableTruth.draw(RIG.turntable, 3).axis.point)
    assert not np.array_equal(truths[3].axis.point, truths[4].axis.point)
    gear = np.array([truths[0].angle(angle) - angle for angle in np.linspace(0, 2 * np.pi, 50)])
    assert gear[0] == 0 and 0 < np.abs(gear).max() < 4 * GEAR_RAD


def test_turning_the_room_is_turning_the_object():
    """Reference: the items that turn are moved themselves, and room and camera stay."""
    scene = stage("shiny_ball", centre=(0.4, 0.0, 0.1), size=(0.2, 0.2, 0.2), seed=0)
    turn = Axis.of(pose.from_rotation_vector([0.02, 0, 0], [0.43, 0.02, 0.0])).base_from_object(1.2)
    moved = [item if item.name in STILL else replace(item, mesh=item.mesh.copy().apply_transform(turn)) for item in scene.items]
    assert any(item.name in STILL for item in scene.items)  # the premise: something stands still
    camera, view = Camera(20, 20, 22.0, 22.0, 10.0, 10.0), pose.look_at((0.1, -0.3, 0.3), (0.4, 0, 0.05))
    reference = Renderer(replace(scene, items=tuple(moved)), using="scalar_rgb")
    turned = Renderer(scene, using="scalar_rgb")
    before = turned.radiance(camera, view, samples=16, seed=1)
    turned.place_room(pose.inverse(turn))
    found = turned.radiance(camera, pose.inverse(turn) @ view, samples=16, seed=1)
    expected = reference.radiance(camera, view, samples=16, seed=1)
    assert np.median(np.abs(before - expected)) > 0.02  # the premise: turning makes a difference
    assert np.quantile(np.abs(found - expected), 0.95) < 1e-3  # a few paths part at an edge, by rounding
    turned.place_room(np.eye(4))
    assert np.quantile(np.abs(turned.radiance(camera, view, samples=16, seed=1) - before), 0.95) < 1e-4


def test_truth_is_in_the_objects_frame(tmp_path):
    """Pixels, depth and pose lead back to the ball where it stood with the table at zero, and normals point away from it."""
    import trimesh

    trajectory = load_trajectory("koala_demo", overrides=["camera.width=48", "camera.height=48"])
    truth = RigTruth.draw(RIG.flange_from_camera.matrix(), 0)
    with SimulatedTurntable(RIG.turntable, seed=0, time_scale=200) as simulation, GrblTurntable(simulation.reached) as table:
        table.turn_to(np.radians(40))
        base_from_object = simulation.base_from_object()
        goal = base_from_object @ [0.4, 0.0, 0.12, 1.0]  # where the ball has gone to
        eye = np.add(goal[:3], (-0.3, -0.1, 0.25))
        arm = StillArm(pose.look_at(eye, goal[:3]) @ pose.inverse(truth.flange_from_camera))
        with SimulatedCamera(trajectory, "shiny_ball", truth, arm, 0, table=simulation) as camera:
            camera.grab()
            camera.save_truth(tmp_path, "000", "test")
    content = files.read_json(tmp_path / "poses.json")
    np.testing.assert_array_equal(content["base_from_object"]["000"], base_from_object)
    axis = Axis.from_json(content["turntable"], where="truth")
    np.testing.assert_allclose(axis.base_from_object(simulation.truth.angle(np.radians(40))), base_from_object, atol=1e-9)
    alpha, normals, depth = (images.read(next((tmp_path / name).iterdir())) for name in ("alpha", "normals", "depth"))
    inside = alpha[..., 0] > 0.999
    assert inside.mean() > 0.1
    lens, base_from_camera = Camera.from_json(content["camera"], where=""), np.array(content["base_from_camera"]["000"])
    world_from_camera = pose.inverse(base_from_object) @ base_from_camera
    points = lens.directions(lens.pixel_centres())[inside] * depth[inside]
    points = points @ world_from_camera[:3, :3].T + world_from_camera[:3, 3]
    ball = trimesh.load(tmp_path / "object.ply")
    centre, radius = ball.bounds.mean(0), ball.extents[0] / 2
    facing = normals[inside] @ world_from_camera[:3, 2] < -0.5
    outward = (points - centre)[facing]
    assert np.abs(np.linalg.norm(outward, axis=-1) - radius).max() < 3e-3  # a pixel is 3 mm wide on the ball
    assert np.einsum("ij,ij->i", outward / radius, normals[inside][facing]).min() > 0.98
