"""Where reflected rays end: on a sphere about the object, against the intersection of ray and sphere in float64."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.config import FieldConfig, LightConfig
from koala3d.reconstruct.field.appearance import Reflection, Start, create_appearance
from koala3d.reconstruct.field.parallax import INSIDE, START, Parallax, ends_on_sphere
from koala3d.reconstruct.scene.light import LightFrame
from tests import drawn

FIELD = FieldConfig(bottleneck=2, view_width=16, ide_degree=3)
COUNT = 200
ENDS = jax.jit(ends_on_sphere)
TOWARDS = jax.jit(lambda parallax, directions, places: parallax.towards(directions, places))


def unit(count: int, seed: int) -> np.ndarray:
    values = np.random.default_rng(seed).normal(size=(3, count))
    return values / np.linalg.norm(values, axis=0)


def some_places(count: int, furthest: float) -> np.ndarray:
    return furthest * np.random.default_rng(2).random(count) * unit(count, 3)


def test_directions_are_those_of_the_intersections() -> None:
    directions, places, radius = unit(COUNT, 0), some_places(COUNT, 3.0), 4.0
    with jax.enable_x64(True):
        found = np.asarray(TOWARDS(Parallax(1 / radius), directions, places))
        assert found.dtype == np.float64
    for d, x, end in zip(directions.T, places.T, radius * found.T, strict=True):
        first, last = np.sort(np.roots([1.0, 2 * x @ d, x @ x - radius**2]).real)
        assert first < 0 < last
        np.testing.assert_allclose(end, x + last * d, atol=1e-12)  # float64 algebra
    assert np.abs(found - directions).max() > 0.3


def test_float32_is_near_float64() -> None:
    directions, places = unit(COUNT, 0), some_places(COUNT, 1.5)
    ours = ENDS(np.float32(directions), np.float32(places))
    with jax.enable_x64(True):
        exact = np.asarray(ENDS(directions, places))
    np.testing.assert_allclose(ours, exact, atol=2e-6)  # the root of 0.19 or more amplifies a rounding at most twofold
    np.testing.assert_allclose(np.linalg.norm(exact, axis=0), 1, atol=1e-12)


def test_an_infinite_sphere_changes_no_bit() -> None:
    directions = np.float32(unit(COUNT, 1))
    np.testing.assert_array_equal(TOWARDS(Parallax(0.0), directions, np.float32(some_places(COUNT, 50.0))), directions)


def test_the_middle_has_no_parallax() -> None:
    directions = np.float32(unit(COUNT, 1))
    np.testing.assert_array_equal(ENDS(directions, 0 * directions), directions)


@pytest.mark.parametrize("learned", [False, True])
def test_gradients_are_finite_on_the_sphere_outside_and_without_direction(learned: bool) -> None:
    """Inwards, outwards and along the sphere; at its middle, on it, far outside; a direction of zeros."""
    x = np.float32([1.0, 0.0, 0.0])
    places = np.stack([np.float32(s) * x for s in (0.0, INSIDE, 1.0, 1e6, 1e-30)] * 4, -1) * 4
    directions = np.repeat(np.stack([x, -x, x[[1, 0, 2]], 0 * x], -1), 5, axis=1)
    parallax = Parallax.of(LightConfig(parallax="learned" if learned else 4.0))
    total = lambda p, d, x: jnp.sum(p.towards(d, x) * jnp.array([[1.0], [2.0], [3.0]]))  # noqa: E731
    value, slopes = jax.jit(jax.value_and_grad(total, (0, 1, 2)))(parallax, directions, places)
    assert np.isfinite(value) and all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes))


def test_the_radius_is_as_stated_and_learned_on_request() -> None:
    assert Parallax.of(LightConfig()) is None
    stated, learned = Parallax.of(LightConfig(parallax=START)), Parallax.of(LightConfig(parallax="learned"))
    assert stated is not None and learned is not None and not jax.tree.leaves(stated)
    directions, places = np.float32(unit(COUNT, 1)), np.float32(some_places(COUNT, 1.0))
    np.testing.assert_allclose(TOWARDS(learned, directions, places), TOWARDS(stated, directions, places), atol=1e-6)

    def off(parallax: Parallax, directions: jax.Array, places: jax.Array) -> jax.Array:
        return jnp.sum((parallax.towards(directions, places) - Parallax(1 / 2).towards(directions, places)) ** 2)

    slope = jax.jit(jax.grad(off))(learned, directions, places).logit
    assert slope is not None and slope < 0, "towards the nearer sphere"


def reflection(parallax: Parallax | None, light: LightFrame | None = None) -> Reflection:
    made = drawn.filled(
        lambda: create_appearance(jax.random.key(0), FIELD, Start(light=light or LightFrame(), parallax=parallax))
    )
    assert isinstance(made, Reflection)
    return made


def test_a_highlight_shifts_with_the_place_where_lamps_are_near() -> None:
    raw = np.repeat(np.asarray(drawn.normal(12, 1)), 30, 1)
    viewdirs, places = np.float32(np.repeat(unit(1, 5), 30, 1)), drawn.array(some_places(30, 1.0))

    @jax.jit
    def both(appearance: Reflection) -> tuple[jax.Array, jax.Array]:
        """What is reflected in these places, and in none."""
        material = appearance.material(jnp.asarray(raw), jnp.zeros((3, 30)))
        ways = (appearance.shade(material, jnp.asarray(viewdirs), places=one) for one in (places, None))
        return tuple(shading.specular for shading in ways)

    shades = {}
    for name, parallax in {"afar": None, "infinite": Parallax(0.0), "near": Parallax(0.25)}.items():
        shades[name], alone = map(np.asarray, both(reflection(parallax)))
        assert (alone == shades["afar"]).all(), "without a place, light comes from afar"
    assert (shades["infinite"] == shades["afar"]).all()
    assert np.ptp(shades["near"], axis=1).max() > 1e-3 and np.ptp(shades["afar"], axis=1).max() < 1e-6


def test_lamps_on_the_camera_keep_their_own_places() -> None:
    assert reflection(Parallax(0.25), LightFrame("camera")).parallax is None
    assert reflection(Parallax(0.25), LightFrame("turntable")).parallax is not None
