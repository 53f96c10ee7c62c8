"""Poses and exposure held against pictures of which the geometry is known."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.checks.matches import CONVENTIONS, check_matches
from koala3d.datasets.conventions import OPENCV_FROM_LLFF, OPENCV_FROM_MITSUBA, OPENCV_FROM_OPENGL
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene

MISTAKES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "OpenGL camera axes (y up, z back) taken for OpenCV's": lambda m: m @ OPENCV_FROM_OPENGL,
    "camera_from_world taken for world_from_camera": pose.inverse,
    "camera_from_world with OpenGL axes taken for world_from_camera": lambda m: OPENCV_FROM_OPENGL @ pose.inverse(m),
    "LLFF's axes (down, right, back) taken for OpenCV's": lambda m: m @ OPENCV_FROM_LLFF,
    "LLFF's axes taken for OpenGL's": lambda m: m @ OPENCV_FROM_LLFF @ OPENCV_FROM_OPENGL,
    "Mitsuba's axes (left, up, forward) taken for OpenGL's": lambda m: m @ OPENCV_FROM_MITSUBA @ OPENCV_FROM_OPENGL,
    "rotations transposed": lambda m: pose.rigid(m[:3, :3].T, m[:3, 3]),
}


def moved(scene: Scene, change: Callable[[np.ndarray], np.ndarray]) -> Scene:
    """The scene with its world turned at random, so that nothing is symmetric, and every pose changed."""
    world = pose.from_rotation_vector((0.4, 0.7, -0.3), (2.0, -1.0, 0.5))
    return scene.with_views(tuple(replace(v, world_from_camera=change(world @ v.world_from_camera)) for v in scene.views))


def test_every_convention_has_its_mistake() -> None:
    matrix = pose.from_rotation_vector((0.4, 0.7, -0.3), (2.0, -1.0, 0.5))
    assert MISTAKES.keys() == CONVENTIONS.keys()
    for name, change in MISTAKES.items():
        assert np.abs(CONVENTIONS[name](change(matrix)) - matrix).max() < 1e-12, name


def test_right_poses_have_no_findings(two_walls: Callable[..., Scene]) -> None:
    assert check_matches(moved(two_walls(), lambda m: m)) == []


@pytest.mark.parametrize("name", MISTAKES)
def test_the_wrong_convention_is_named(two_walls: Callable[..., Scene], name: str) -> None:
    found = check_matches(moved(two_walls(), MISTAKES[name]))
    assert len(found) == 1 and found[0].level == "error" and "another convention" in found[0].what
    assert f"after correcting: {name}" in found[0].why


def test_poses_of_another_scene_are_reported(two_walls: Callable[..., Scene]) -> None:
    scene, random = two_walls(), np.random.default_rng(0)
    turned = [pose.from_rotation_vector(random.normal(0, 0.2, 3)) for _ in scene.views]
    views = tuple(replace(v, world_from_camera=v.world_from_camera @ t) for v, t in zip(scene.views, turned, strict=True))
    found = check_matches(scene.with_views(views))
    assert [f.what for f in found] == ["poses do not explain the pictures"] and "order of images" in found[0].remedy


def test_a_single_wrong_pose_is_named(two_walls: Callable[..., Scene]) -> None:
    scene = two_walls()
    views = list(scene.views)
    views[4] = replace(views[4], world_from_camera=views[4].world_from_camera @ pose.from_rotation_vector((0, 0, 0.3)))
    found = check_matches(scene.with_views(tuple(views)))
    assert [f.where for f in found] == ["view 04"] and "does not fit" in found[0].what


def test_drifting_exposure_is_measured(two_walls: Callable[..., Scene]) -> None:
    """Two views of half and of twice the light, written back in sRGB."""
    scene = two_walls()
    for index, gain in ((3, 0.5), (8, 2.0)):
        light = gain * images.linear_from_srgb(images.read(scene.views[index].image))
        images.write(scene.views[index].image, images.srgb_from_linear(light).clip(0, 1))
    (found,) = check_matches(scene)
    assert "exposure drifts" in found.what and "2 of 12 views" in found.where
    gains = dict(word.split(": ") for word in found.why.split("median view: ")[1].split(", "))
    assert float(gains["03"]) == pytest.approx(0.5, rel=0.1) and float(gains["08"]) == pytest.approx(2.0, rel=0.15)


def test_no_findings_where_nothing_can_be_matched(two_walls: Callable[..., Scene]) -> None:
    scene = two_walls()
    for view in scene.views:
        images.write(view.image, np.full((150, 200, 3), 0.5))
    assert check_matches(moved(scene, MISTAKES["rotations transposed"])) == []
