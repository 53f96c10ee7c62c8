"""Rays against a ball, where everything is known in closed form, and against two of them that mirror each other."""

import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.rendered.light import MATTE, Light
from koala3d.reconstruct.rendered.solids import ball, placed
from koala3d.reconstruct.rendered.tracer import Body, Material, Tracer

SILVER = Material((0.0, 0.0, 0.0), (0.9, 0.9, 0.9), 300.0)
CLAY = Material((0.5, 0.4, 0.3), (0.0, 0.0, 0.0), 10.0)
LIGHT = Light.studio(0)


def _rays(count: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    """Origins four units away, unit directions roughly towards the middle."""
    rng = np.random.default_rng(0)
    origins = rng.normal(size=(count, 3))
    origins *= 4 / np.linalg.norm(origins, axis=-1, keepdims=True)
    directions = rng.uniform(-0.9, 0.9, (count, 3)) - origins
    return origins, directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def test_hits_of_a_ball_are_where_geometry_says() -> None:
    origins, directions = _rays()
    found = Tracer((Body(ball(0.7), SILVER),), LIGHT).look(origins, directions)
    closest = -(origins * directions).sum(-1)
    inside = 0.49 - ((origins + closest[:, None] * directions) ** 2).sum(-1)
    clear = np.abs(inside) > 1e-3  # a ray that creeps along the rim counts as a hit
    np.testing.assert_array_equal(found["t"][clear] > 0, inside[clear] > 0)
    hit = clear & (inside > 0.01)
    exact = closest[hit] - np.sqrt(inside[hit])
    np.testing.assert_allclose(found["t"][hit], exact, atol=2e-4)  # 1e-5 of distance, at up to 80 degrees
    np.testing.assert_allclose(found["normals"][hit], (origins[hit] + exact[:, None] * directions[hit]) / 0.7, atol=5e-4)


def test_a_mirror_shows_the_light_behind_the_camera() -> None:
    tracer = Tracer((Body(ball(0.7), SILVER),), LIGHT)
    back = np.array([0.0, 0.6, 0.8])
    seen = tracer.look(4 * back[None], -back[None])
    expected = 0.9 * LIGHT.convolved(jnp.asarray(back, jnp.float32)[:, None], 300.0)[:, 0]
    np.testing.assert_allclose(seen["specular"][0], expected, rtol=2e-3)
    assert not seen["diffuse"].any()


def test_matte_light_does_not_depend_on_the_view() -> None:
    tracer = Tracer((Body(ball(0.7), CLAY),), LIGHT)
    point = np.array([0.7, 0.0, 0.0])
    origins = np.array([[4.0, 0, 0], [3, 2, 1], [3, -1, 2]])
    directions = (point - origins) / np.linalg.norm(point - origins, axis=-1, keepdims=True)
    seen = tracer.look(origins, directions)["diffuse"]
    expected = np.array(CLAY.matte) * np.asarray(LIGHT.convolved(jnp.array([[1.0], [0], [0]]), MATTE))[:, 0]
    np.testing.assert_allclose(seen, np.broadcast_to(expected, seen.shape), rtol=2e-3)


def test_a_mirror_shows_what_stands_before_it() -> None:
    """A clay ball beside a mirror: where the mirrored ray meets it, its clay is seen, elsewhere the light."""
    mirror, clay = Body(placed(ball(0.4), (-0.45, 0, 0)), SILVER), Body(placed(ball(0.4), (0.45, 0, 0)), CLAY)
    origins, directions = _rays(20_000)
    both, alone = (Tracer(bodies, LIGHT).look(origins, directions) for bodies in ((mirror, clay), (mirror,)))
    on_mirror = (both["t"] > 0) & (np.linalg.norm(origins + both["t"][:, None] * directions - [-0.45, 0, 0], axis=-1) < 0.41)
    normal = both["normals"][on_mirror]
    mirrored = directions[on_mirror] - 2 * (directions[on_mirror] * normal).sum(-1, keepdims=True) * normal
    start = origins[on_mirror] + both["t"][on_mirror, None] * directions[on_mirror] - [0.45, 0, 0]
    nearest = start - (start * mirrored).sum(-1, keepdims=True) * mirrored
    towards = (start * mirrored).sum(-1) < 0
    gap = np.linalg.norm(nearest, axis=-1) - 0.4
    meets, misses = towards & (gap < -0.01), ~towards | (gap > 0.01)
    assert meets.sum() > 50 and misses.sum() > 50
    changed = np.abs(both["specular"][on_mirror] - alone["specular"][on_mirror]).max(-1) > 1e-3
    assert changed[meets].mean() > 0.98 and not changed[misses].any()


@pytest.mark.parametrize("count", [1, 8192, 8193])
def test_any_number_of_rays(count: int) -> None:
    origins, directions = np.tile([[0.0, 0, 4]], (count, 1)), np.tile([[0.0, 0, -1]], (count, 1))
    seen = Tracer((Body(ball(0.5), SILVER),), LIGHT).look(origins, directions)
    assert seen["t"].shape == (count,)
    np.testing.assert_allclose(seen["t"], 3.5, atol=2e-5)
