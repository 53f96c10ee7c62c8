import json
from functools import partial

import numpy as np
import pytest
import trimesh

from koala3d.capture.cli import main
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.planning import plan
from koala3d.capture.sessions.adaptive import gain, known_shape
from koala3d.capture.sessions.adaptive.candidates import see
from koala3d.capture.sessions.adaptive.shape import eye_of
from koala3d.datasets.core.errors import UsageError


@pytest.fixture
def mesh_file(tmp_path):
    """A ball of 10 cm radius on the table, in the middle of the object's box."""
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    mesh.apply_translation([0.4, 0.0, 0.1])
    mesh.export(tmp_path / "ball.ply")
    return tmp_path / "ball.ply"


def test_what_the_object_stands_on_is_left_out(tmp_path, trajectory):
    block = trimesh.creation.box((0.1, 0.1, 0.1))
    block.apply_translation([0.4, 0.0, 0.05])
    block.export(tmp_path / "block.stl")
    places = known_shape.surface_of(tmp_path / "block.stl", trajectory)
    assert places.shares.sum() == pytest.approx(1) and places.normals[:, 2].min() > -0.1
    assert places.shares[places.normals[:, 2] > 0.9].sum() == pytest.approx(1 / 5, abs=0.01)


def test_a_mesh_elsewhere_or_in_millimetres_is_named(tmp_path, trajectory, mesh_file):
    mesh = trimesh.load_mesh(mesh_file)
    mesh.apply_scale(1000.0)
    mesh.export(tmp_path / "large.ply")
    with pytest.raises(UsageError, match=r"large\.ply: the mesh is not inside the object's box.*--mesh-scale 0\.001"):
        known_shape.surface_of(tmp_path / "large.ply", trajectory)
    assert known_shape.surface_of(tmp_path / "large.ply", trajectory, 0.001).points.max() < 0.55
    with pytest.raises(UsageError, match=r"the mesh cannot be read .*no such file"):
        known_shape.surface_of(tmp_path / "none.ply", trajectory)


def test_views_of_a_plan_are_not_crowded(carrier, trajectory, mesh_file):
    """The median view is more than 15 degrees from its nearest neighbour; views that only cover stand 11 degrees apart."""
    places, eye = known_shape.surface_of(mesh_file, trajectory), eye_of(carrier.flange_from_camera, None)
    cover = known_shape.cover(trajectory, carrier, places, eye=eye, camera=None, views=24)
    ways = directions([view.base_from_camera for view in cover.trajectory.viewpoints() if view.split == "train"])
    cosines = ways @ ways.T - 2 * np.eye(len(ways))
    apart = np.degrees(np.arccos(np.clip(cosines.max(1), -1, 1)))
    assert np.median(apart) > 15


def directions(poses: list[np.ndarray]) -> np.ndarray:
    """(n, 3) unit directions from the object's middle to cameras."""
    ways = np.stack(poses)[:, :3, 3] - [0.4, 0.0, 0.1]
    return np.asarray(ways / np.linalg.norm(ways, axis=1, keepdims=True))


def test_greedy_cover_takes_the_fewest_first(candidates, obstacles, carrier, trajectory, mesh_file):
    places = known_shape.surface_of(mesh_file, trajectory)
    seen = see(candidates, places, obstacles, eye_of(carrier.flange_from_camera, None), None)
    chosen = known_shape.greedy(places, seen, 1.0, 999)
    assert len(set(chosen)) == len(chosen) < len(candidates)
    part = known_shape.greedy(places, seen, 0.8, 999)
    assert part == chosen[: len(part)] and known_shape.greedy(places, seen, 1.0, 5) == chosen[:5]
    covered = [
        gain.coverage(places, gain.Seen(seen.facing[chosen[:n]], seen.eyes[chosen[:n]]), seen).covered
        for n in range(len(chosen) + 1)
    ]
    assert covered == sorted(covered) and covered[len(part)] >= 0.8 > covered[len(part) - 1] and covered[-1] > 0.97
    random = np.random.default_rng(0).permutation(len(candidates))[: len(part)]
    assert gain.coverage(places, gain.Seen(seen.facing[random], seen.eyes[random]), seen).covered < 0.8


@pytest.fixture(scope="module")
def capture(run_inside):
    """Runs the command inside this process."""
    return partial(run_inside, main, "capture")


SMALL = ["--set", "views.0.count=20", "--set", "views.0.rings=3", "--set", "split={train: 16, test: 4}"]


def test_the_written_trajectory_is_one_like_others(capture, tmp_path, mesh_file, carrier):
    out = tmp_path / "views.yaml"
    done = capture("plan", "koala_demo", "--for-mesh", mesh_file, "--views", 9, "--out", out, "--json", *SMALL)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["splits"] == {"train": 9, "test": 4} and 0.3 < found["covered"] <= 1 and found["reachable"] > 0.5
    trajectory = load_trajectory(out)
    assert [view.split for view in trajectory.viewpoints()].count("test") == 4
    cameras = [view.viewpoint.base_from_camera for view in plan(trajectory, carrier) if view.viewpoint.split == "train"]
    places = known_shape.surface_of(mesh_file, trajectory)
    shares = known_shape.covered_after(places, np.stack(cameras), None)
    assert shares == sorted(shares) and shares[-1] == pytest.approx(found["covered"] * found["reachable"], abs=0.02)
    told = json.loads(capture("plan", out, "--coverage", mesh_file, "--json").stdout)
    assert len(told["covered_after"]) == 9 and told["covered"] == pytest.approx(shares[-1], abs=0.02)
    assert capture("plan", "koala_demo", "--for-mesh", mesh_file, "--out", out).returncode == 2, "it is not overwritten"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["plan"], "no TRAJECTORY is given"),
        (["plan", "koala_demo", "--views", "9"], "--views: is for a known shape; add --for-mesh"),
        (["plan", "calibration", "--for-mesh", "x.ply"], "looks at a calibration target"),
        (["plan", "koala_turntable", "--for-mesh", "x.ply"], "turns no turntable"),
        (["run", "koala_demo", "--views", "9", "--out", "x"], "--views: is for sessions that choose their views; add --adaptive"),
        (["run", "koala_demo", "--adaptive", "--view", "--out", "x"], "capture view RECORDING"),
        (["run", "calibration", "--adaptive", "--out", "x"], "use 'capture calibrate'"),
        (["plan", "koala_demo", "--coverage", "none.ply"], "none.ply"),
    ],
)
def test_misuse_is_one_line(capture, words, message):
    done = capture(*words)
    assert done.returncode == 2 and done.stderr.count("error:") == 1 and message in " ".join(done.stderr.split()), done.stderr
