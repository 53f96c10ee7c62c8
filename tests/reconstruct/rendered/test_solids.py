"""Distances against brute force, normals against differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from koala3d.reconstruct.rendered import solids
from koala3d.reconstruct.rendered.shiny import SCENES

SOLIDS = {
    "ball": solids.ball(0.6),
    "torus": solids.torus(0.5, 0.2),
    "block": solids.block((0.5, 0.3, 0.2), 0.1),
    "puck": solids.puck(0.5, 0.2, 0.08),
    "rod": solids.rod((-0.3, 0.1, 0.0), (0.4, -0.2, 0.3), 0.15),
    "placed": solids.placed(solids.block((0.4, 0.2, 0.1), 0.05), (0.2, -0.1, 0.1), (30, 50, -20)),
}


def _measured(solid, points: np.ndarray) -> np.ndarray:
    """Distance of (n, 3) points."""
    return np.asarray(jax.jit(solid)(jnp.asarray(points.T)))


def _surface(solid, count: int = 20_000) -> np.ndarray:
    """(n, 3) points of the surface: random ones that are moved along the gradient until the distance is zero."""
    points = np.random.default_rng(0).uniform(-0.9, 0.9, (3, count)).astype(np.float32)
    closer = lambda _, p: p - solid(p) * solids.normals(solid, p)  # noqa: E731
    moved = np.asarray(jax.jit(lambda p: jax.lax.fori_loop(0, 12, closer, p))(points)).T
    on = np.abs(_measured(solid, moved)) < 1e-5
    assert on.mean() > 0.9
    return moved[on]


@pytest.mark.parametrize("name", SOLIDS)
def test_distance_is_that_of_the_nearest_point_of_the_surface(name: str) -> None:
    solid = SOLIDS[name]
    points = np.random.default_rng(1).uniform(-1, 1, (400, 3)).astype(np.float32)
    nearest, _ = cKDTree(_surface(solid)).query(points)
    # 18,000 points on a surface of about 3 leave gaps of 0.02
    np.testing.assert_allclose(np.abs(_measured(solid, points)), nearest, atol=0.02)


@pytest.mark.parametrize("name", ["teapot", "three_metals"])
def test_no_scene_promises_more_than_its_distance(name: str) -> None:
    """What sphere tracing rests on: nothing is nearer than the distance says."""
    tracer = SCENES[name]()
    surface = _surface(tracer.distance)
    assert (np.linalg.norm(surface, axis=-1) < 1).all(), "the scene leaves its ball"
    points = np.random.default_rng(1).uniform(-1, 1, (400, 3)).astype(np.float32)
    nearest, _ = cKDTree(surface).query(points)
    assert (_measured(tracer.distance, points) < nearest + 1e-4).all()


@pytest.mark.parametrize("name", ["teapot", "three_metals"])
def test_normals_are_the_slope_of_the_distance(name: str) -> None:
    distance = SCENES[name]().distance
    points = jnp.asarray(_surface(distance)[:500].T)
    step = 1e-3  # the distance has noise of 1e-7: slopes of 1e-4
    moved = lambda p, axis, by: distance(p.at[axis].add(by))  # noqa: E731
    slopes = jax.jit(lambda p: jnp.stack([moved(p, axis, step) - moved(p, axis, -step) for axis in range(3)]) / (2 * step))
    slope = np.array(slopes(points))
    slope /= np.linalg.norm(slope, axis=0)  # where bodies melt into each other the distance rises more slowly
    apart = np.linalg.norm(np.asarray(jax.jit(lambda p: solids.normals(distance, p))(points)) - slope, axis=0)
    assert np.median(apart) < 1e-3
    assert np.mean(apart < 0.02) > 0.97  # the rest lies within a step of an edge between two bodies


def test_blending_melts_only_what_is_close() -> None:
    first, second = solids.placed(solids.ball(0.3), (-0.25, 0, 0)), solids.placed(solids.ball(0.3), (0.25, 0, 0))
    both = solids.blended(0.2, first, second)
    far, between = jnp.array([[-0.55], [0.0], [0.0]]), jnp.array([[0.0], [0.2], [0.0]])
    np.testing.assert_allclose(both(far), first(far), atol=1e-7)
    assert both(between) < jnp.minimum(first(between), second(between)) - 0.04  # a quarter of the reach, 0.05, at most
