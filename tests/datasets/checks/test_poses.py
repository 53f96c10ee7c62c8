from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.checks.poses import check_poses
from koala3d.datasets.core.findings import Finding
from koala3d.datasets.scene import Scene


def words(found: list[Finding]) -> list[str]:
    return [finding.line for finding in found]


def test_a_sound_scene_has_no_findings(make_scene: Callable[..., Scene]) -> None:
    assert check_poses(make_scene()) == []


def test_leakage_names_both_views_and_how_close_they_are(make_scene: Callable[..., Scene]) -> None:
    """A test camera 1 mm beside a training camera that stands half a metre away; one 10 mm away is no leak."""
    scene = make_scene()
    views = list(scene.views)
    beside = pose.rigid(np.eye(3), (1e-3, 0, 0))
    views[4] = replace(views[4], world_from_camera=views[3].world_from_camera @ beside)
    views[8] = replace(views[8], world_from_camera=views[7].world_from_camera @ pose.rigid(np.eye(3), (1e-2, 0, 0)))
    (found,) = check_poses(scene.with_views(tuple(views)))
    assert found.where == "view 004" and "view 003 is 0.2" in found.why


@pytest.mark.parametrize(("factor", "expected"), [(1.0, 0), (1000.0, 1), (1e-3, 1)])
def test_scale(make_scene: Callable[..., Scene], factor: float, expected: int) -> None:
    scene = make_scene()
    views = tuple(
        replace(v, world_from_camera=pose.rigid(v.world_from_camera[:3, :3], factor * v.world_from_camera[:3, 3]))
        for v in scene.views
    )
    grown = replace(scene.with_views(views), box=factor * scene.box, near=factor * scene.near)
    assert len([line for line in words(check_poses(grown)) if "scale is implausible" in line]) == expected
    assert not any("implausible" in line for line in words(check_poses(replace(grown, metric=False))))


def test_bounds_in_another_unit(make_scene: Callable[..., Scene]) -> None:
    scene = replace(make_scene(), near=100.0)
    assert any("near and far leave out where the cameras look" in line for line in words(check_poses(scene)))


@pytest.mark.parametrize(("change", "expected"), [
    ({"cx": 90.0}, "principal point is far from the middle ((90.0, 36.0) in an image of 96x72)"),
    ({"fy": 60.0}, "pixels are not square (fx 90.0, fy 60.0)"),
])  # fmt: skip
def test_strange_intrinsics(make_scene: Callable[..., Scene], change: dict, expected: str) -> None:
    scene = make_scene(replace(Camera(96, 72, 90.0, 90.0, 48.0, 36.0), **change))
    found = [line for line in words(check_poses(scene)) if "camera of view 000" in line]
    assert len(found) == 1 and expected in found[0]
