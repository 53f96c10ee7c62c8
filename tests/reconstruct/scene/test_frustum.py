"""The space of cameras that all look the same way, against float64 references."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.scene import View
from koala3d.reconstruct.sampling.steps import Steps
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.frustum import Frustum, frustum_of
from koala3d.reconstruct.scene.rays import Normalisation, Rays
from tests import drawn

NEAR, FAR = 0.5, 6.0


def views_towards(angles_deg: tuple[float, ...], apart: float = 0.1) -> tuple[View, ...]:
    """Cameras in a row, each turned about the vertical axis."""
    views = []
    for index, angle in enumerate(np.deg2rad(angles_deg)):
        matrix = np.eye(4)
        matrix[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        matrix[0, 3] = apart * index
        views.append(View(f"{index}", Camera(64, 48, 60.0, 60.0, 32.0, 24.0), matrix, "train", Path(f"{index}.png")))
    return tuple(views)


def frustum(views: tuple[View, ...]) -> Frustum:
    found = frustum_of(views, (0.0, 0.0, 0.0), 1.0, NEAR, FAR)
    assert found is not None
    return found


SPACE = frustum(views_towards((-4, 1, 3)))


def reference(points: np.ndarray) -> np.ndarray:
    """The docstring's formula in float64."""
    u, v, w = np.asarray(SPACE.rotation) @ (points - SPACE.origin).T
    depth = 1 - 2 * (1 / w - 1 / SPACE.far) / (1 / SPACE.near - 1 / SPACE.far)
    return np.stack([u / w / SPACE.across, v / w / SPACE.across, SPACE.deep * depth], -1)


def points(count: int = 200) -> np.ndarray:
    """Places all over the frustum."""
    mapped = np.random.default_rng(0).uniform(-0.99, 0.99, (count, 3)) * [1, 1, SPACE.deep]
    return SPACE.scene_points(mapped)


def test_it_equals_the_formula_and_its_inverse() -> None:
    mapped = jax.jit(SPACE.mapped)(np.float32(points()))
    np.testing.assert_allclose(mapped, reference(points()), atol=1e-5)  # float32 of disparities up to 2
    np.testing.assert_allclose(SPACE.scene_points(reference(points())), points(), atol=1e-9)


def test_all_that_the_cameras_see_lies_in_the_cube_and_fills_it() -> None:
    views = views_towards((-4, 1, 3))
    corners = []
    for view in views:
        rays = view.camera.directions([[0, 0], [64, 0], [0, 48], [64, 48]]) @ view.world_from_camera[:3, :3].T
        corners.append(view.world_from_camera[:3, 3] + np.concatenate([rays * NEAR, rays * FAR]))
    mapped = reference(np.concatenate(corners))
    assert np.abs(mapped[:, :2]).max() == pytest.approx(1)
    assert np.abs(mapped[:, 2]).max() == pytest.approx(SPACE.deep)


def test_pull_back_applies_the_transposed_jacobian() -> None:
    gradients = np.random.default_rng(1).normal(size=(200, 3))
    both = jax.jit(lambda p, g: (SPACE.pull_back(p, g), jax.vjp(SPACE.mapped, p)[1](g)[0]))
    pulled, own = both(np.float32(points()), np.float32(gradients))
    np.testing.assert_allclose(pulled, own, rtol=1e-4, atol=1e-5)  # float32, other order of products


def test_scale_is_the_slope_across_the_axis() -> None:
    there, step = points(), 1e-6
    moved = reference(there + step * np.asarray(SPACE.rotation[0]))
    slope = np.linalg.norm(moved - reference(there), axis=-1) / step
    np.testing.assert_allclose(jax.jit(SPACE.scale)(np.float32(there)), slope, rtol=1e-4)


def test_steps_are_even_along_the_map() -> None:
    view = views_towards((-4, 1, 3))[1]
    position, direction = view.world_from_camera[:3, 3], view.world_from_camera[:3, 2]
    rays = Rays(drawn.array(position[None]), drawn.array(direction[None]), drawn.array([1.0]))

    @jax.jit
    def at(rays: Rays) -> jax.Array:
        steps = Steps.of(rays, steps=32, space=SPACE, near=NEAR, far=FAR)
        assert steps.count == 32
        return steps.at(jnp.arange(33.0)[None])[0]

    t = np.asarray(at(rays))
    assert (t[0], t[-1]) == pytest.approx((NEAR, FAR), rel=1e-6)
    np.testing.assert_allclose(np.diff(1 / t), (1 / FAR - 1 / NEAR) / 32, rtol=1e-4)


@pytest.mark.parametrize("angles", [(-60, 0, 60), (0, 180, 0), (-20, 0, 75)])
def test_cameras_that_look_different_ways_have_none(angles: tuple[float, ...]) -> None:
    assert frustum_of(views_towards(angles), (0.0, 0.0, 0.0), 1.0, NEAR, FAR) is None


def test_behind_the_cameras_everything_is_finite() -> None:
    behind = np.float32([[0.0, 0, -1], [0, 0, 0], [0, 0, -1e6], [1e6, 0, 0.1]])
    every = jax.jit(lambda p: (SPACE.mapped(p), SPACE.pull_back(p, jnp.ones_like(p)), SPACE.scale(p)))
    assert all(np.isfinite(values).all() for values in every(behind))


def test_a_run_keeps_it() -> None:
    normalisation = Normalisation((0.0, 0.0, 0.0), 1.0, False, NEAR, FAR, frustum=SPACE)
    facts = SceneFacts(normalisation)
    assert SceneFacts.from_json(facts.to_json()) == facts
    assert replace(normalisation, frustum=None).space != normalisation.space == SPACE
