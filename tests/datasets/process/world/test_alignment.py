"""`datasets edit`: an existing scene gets metres and an upward z axis."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.cli import app
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.formats import koala, load_scene
from koala3d.datasets.process.world import alignment
from koala3d.datasets.process.world.alignment import Wishes
from koala3d.datasets.process.world.similarity import Similarity, upwards
from koala3d.datasets.scene import TURNED, Scene


def aligned(scene: Scene, folder: Path, *words: object) -> Scene:
    koala.save(scene, folder / "old")
    app(["edit", str(folder / "old"), "--out", str(folder / "new"), "--json", *map(str, words)], standalone_mode=False)
    return load_scene(folder / "new")


def test_the_marker_gives_metres_and_up(shots, tilted: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = aligned(tilted, tmp_path, "--marker-mm", 240)
    facts = json.loads(capsys.readouterr().out)
    assert facts["metric"] and "4X4_1000 7" in facts["scale_from"] and "printed marker" in facts["up_from"]
    assert scene.metric and len(scene.views) == 10
    for view in scene.views:  # the world is turned about z and shifted along the table only
        height = shots.poses[view.name][2, 3]
        assert view.world_from_camera[2, 3] == pytest.approx(height, abs=0.03)  # marker of 60 px, corners to 0.3 px


def test_positions_give_their_world(shots, tilted: Scene, tmp_path: Path) -> None:
    lines = [f"{name} {x} {y} {z}" for name, matrix in shots.poses.items() for x, y, z in [matrix[:3, 3]]]
    (tmp_path / "arm.txt").write_text("\n".join(lines))
    scene = aligned(tilted, tmp_path, "--positions", tmp_path / "arm.txt")
    assert scene.metric
    for view in scene.views:
        np.testing.assert_allclose(view.world_from_camera, shots.poses[view.name], atol=1e-9)


def test_without_wishes_only_the_direction_changes(tilted: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = aligned(replace(tilted, notes=("kept",)), tmp_path, "--up", "auto")
    facts = json.loads(capsys.readouterr().out)
    assert not facts["metric"] and "--marker-mm" in facts["hint"] and scene.notes == ("kept",)
    old, new = ([view.world_from_camera[:3, 3] for view in found.views] for found in (tilted, scene))
    assert np.linalg.norm(new[0] - new[5]) == pytest.approx(np.linalg.norm(old[0] - old[5]))
    assert all(0.3 < place[2] < 0.8 for place in new)  # half of 0.8 to 1.2 m above the table
    with pytest.raises(UsageError, match="already exists"):
        app(["edit", str(tmp_path / "old"), "--out", str(tmp_path / "new")], standalone_mode=False)


def test_stated_bounds_move_along(tilted: Scene) -> None:
    stated = replace(tilted, bounds_from="stated", near=0.2, far=3.0)
    moved = alignment.moved(stated, Similarity(2.0, upwards([0, 1, 0]), np.array([1.0, 0, 0])), metric=True)
    assert (moved.near, moved.far) == (0.4, 6.0) and moved.bounds_from == "stated" and moved.metric
    np.testing.assert_allclose(moved.box, [[1.0, -8.0, 2.0], [5.0, -4.0, 6.0]], atol=1e-12)


@pytest.mark.parametrize(("kind", "complaint"), [("marker", "up cannot be taken from a marker"), ("plane", "from a plane")])
def test_up_that_is_not_there_is_refused(tilted: Scene, kind: str, complaint: str) -> None:
    points = np.random.default_rng(0).uniform([0.5, 1.5, 2.5], [1.5, 2.5, 3.5], (200, 3))
    with pytest.raises(UsageError, match=complaint):
        alignment.align(replace(tilted, points=points), {}, Wishes(up=kind))


def test_no_marker_no_metres(tilted: Scene) -> None:
    with pytest.raises(UsageError, match="no printed marker was found"):
        alignment.align(tilted, {}, Wishes(marker_m=0.04))
    kept = alignment.align(tilted, {}, Wishes(up="none"))
    assert kept.up_from is None and kept.scene.views[0].world_from_camera == pytest.approx(tilted.views[0].world_from_camera)


def test_the_motion_of_an_object_that_was_turned_over_moves_along(tilted: Scene) -> None:
    """A place of the object goes from b to a in either world; what is uncertain along one axis is so along where it went."""
    motion, middle = pose.from_rotation_vector([3.0, 0.1, 0.2], [0.3, 0.2, 0.1]), np.array([0.1, 0.2, 0.3])
    stated = {"a_from_b": motion.tolist(), "middle": middle.tolist(), "covariance": np.diag([1.0, 4, 9, 2, 3, 5]).tolist()}
    scene = replace(tilted, provenance={TURNED: stated | {"views": ["one"]}})
    world = Similarity(2.0, upwards([0, 1, 0]), np.array([1.0, 0, 0]))
    found = alignment.moved(scene, world, metric=True).provenance[TURNED]
    place = np.array([0.4, -0.2, 0.1])
    in_a = motion[:3, :3] @ place + motion[:3, 3]
    in_new = np.array(found["a_from_b"]) @ np.append(world.points(place), 1)
    np.testing.assert_allclose(in_new[:3], world.points(in_a), atol=1e-12)
    np.testing.assert_allclose(found["middle"], world.points(middle))
    axis = np.append(world.rotation[:, 1], np.zeros(3))
    assert axis @ np.array(found["covariance"]) @ axis == pytest.approx(4 * 2**2)
    assert found["views"] == ["one"] and scene.provenance[TURNED]["middle"] == middle.tolist()
