import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.config import FieldConfig
from koala3d.reconstruct.field.appearance import Material, Matte, Reflection, Shading, Start, ViewColour, create_appearance
from koala3d.reconstruct.field.encodings.directional import ide_channels
from koala3d.reconstruct.numerics.safe import linear_from_srgb
from tests import drawn

KINDS = ("reflection", "view", "view_diffuse", "diffuse")
COUNT = 50
VIEWDIRS = np.asarray(drawn.directions(COUNT, seed=2))
POINTS = np.asarray(drawn.uniform(3, COUNT, low=-1, seed=3))


def small(kind: str, **changes: object) -> FieldConfig:
    sizes = {"bottleneck": 4, "view_width": 16, "ide_degree": 3}
    return FieldConfig.model_validate({"appearance": kind, **sizes, **changes})


def created(config: FieldConfig, start: Start | None = None):
    made = drawn.filled(lambda: create_appearance(jax.random.key(0), config, start))
    towards = start.towards if start else None
    return made if towards is None else eqx.tree_at(lambda one: one.start.towards, made, drawn.array(towards))


@jax.jit
def seen(appearance, raw: jax.Array, points: jax.Array, viewdirs: jax.Array, normals=None) -> tuple[Material, Shading]:
    """The material of a network's outputs, and what it shows."""
    material = appearance.material(raw, points)
    return material, appearance.shade(material, viewdirs, normals)


def some_raw(appearance) -> np.ndarray:
    """A network's outputs, of order one."""
    return np.asarray(drawn.normal(appearance.heads + 4, COUNT, seed=1))


def untrained(appearance) -> np.ndarray:
    """A network's outputs when nothing has been learned."""
    return np.zeros((appearance.heads + 4, COUNT), np.float32)


@pytest.fixture(scope="module", params=KINDS)
def appearance(request: pytest.FixtureRequest):
    return created(small(request.param))


def test_a_material_is_in_range_and_stacks(appearance) -> None:
    material = jax.tree.map(np.asarray, seen(appearance, some_raw(appearance), POINTS, VIEWDIRS)[0])
    assert 0 <= material.diffuse.min() <= material.diffuse.max() < 1
    assert 0 <= material.tint.min() <= material.tint.max() <= 1
    assert material.roughness.min() >= 0
    length = np.linalg.norm(material.normals_pred, axis=0)
    np.testing.assert_allclose(length, 1.0 if appearance.predicts_normals else 0.0, atol=1e-5)
    again = jax.jit(lambda material: Material.unstacked(material.stacked()))(material)
    for name in ("diffuse", "tint", "roughness", "normals_pred", "bottleneck"):
        np.testing.assert_array_equal(getattr(again, name), getattr(material, name))


def test_colour_is_the_curve_of_diffuse_plus_specular(appearance) -> None:
    """All appearances: linear parts add up to what sRGB shows, within float32 and the padding of 0.001."""
    material, shading = jax.tree.map(np.asarray, seen(appearance, some_raw(appearance), POINTS, VIEWDIRS))
    linear = np.asarray(material.diffuse + shading.specular, np.float64)
    curve = np.where(linear > 0.0031308, 1.055 * linear ** (1 / 2.4) - 0.055, 12.92 * linear)
    np.testing.assert_allclose(shading.rgb, np.clip(curve, 0, 1) * 1.002 - 0.001, atol=1e-5)
    assert (shading.specular <= material.tint).all()


def test_what_is_matte_looks_alike_from_all_sides() -> None:
    appearance = created(small("diffuse"))
    one, other = (seen(appearance, some_raw(appearance), POINTS, sign * VIEWDIRS)[1] for sign in (1, -1))
    np.testing.assert_array_equal(one.rgb, other.rgb)
    assert not np.any(one.specular) and not jax.tree.leaves(eqx.tree_at(lambda one: one.start, appearance, None))


def test_which_parts_each_has() -> None:
    made = {kind: created(small(kind)) for kind in KINDS}
    assert isinstance(made["reflection"], Reflection) and isinstance(made["view"], ViewColour)
    assert isinstance(made["diffuse"], Matte)
    assert [made[kind].has_diffuse for kind in KINDS] == [True, False, True, True]
    assert [made[kind].heads for kind in KINDS] == [10, 0, 3, 6]
    assert not np.any(seen(made["view"], some_raw(made["view"]), POINTS, VIEWDIRS)[0].diffuse)


def test_view_colour_depends_on_the_direction_alone_and_not_on_normals() -> None:
    appearance = created(small("view"))
    ways = {"plain": (VIEWDIRS,), "turned": (VIEWDIRS, -VIEWDIRS), "behind": (-VIEWDIRS,)}
    shades = {name: seen(appearance, some_raw(appearance), POINTS, *way)[1] for name, way in ways.items()}
    rgb = np.asarray(shades["plain"].rgb)
    np.testing.assert_array_equal(rgb, shades["turned"].rgb)
    assert np.abs(np.asarray(shades["behind"].rgb) - rgb).max() > 1e-3
    np.testing.assert_allclose(jax.jit(linear_from_srgb)((rgb + 0.001) / 1.002), shades["plain"].specular, atol=1e-5)


def test_reflection_follows_the_law_of_reflection() -> None:
    """Looking down at 45 degrees onto a floor one sees what lies ahead and up at 45 degrees."""
    appearance, half = created(small("reflection")), np.float32(np.sqrt(0.5))
    floor = np.float32([[0.0], [0.0], [1.0]])

    @jax.jit
    def reflected(raw: jax.Array, viewdirs: jax.Array, normals: jax.Array) -> jax.Array:
        found = []
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                "koala3d.reconstruct.field.appearance.integrated_directional_encoding",
                lambda d, r, n: found.append(d) or jnp.zeros((ide_channels(n), 1)),
            )
            appearance.shade(appearance.material(raw, viewdirs), viewdirs, normals=normals)
        return found[0]

    found = reflected(some_raw(appearance)[:, :1], np.float32([[half], [0.0], [-half]]), floor)
    np.testing.assert_allclose(found, [[half], [0], [half]], atol=1e-6)


def test_gradients_are_finite(appearance) -> None:
    """At raw outputs that saturate every head, zeros and large values included."""
    raw = np.tile(np.float32([0.0, 80.0, -80.0]), (appearance.heads + 4, 1))

    def total(raw: jax.Array) -> jax.Array:
        shading = appearance.shade(appearance.material(raw, jnp.zeros((3, 3))), jnp.ones((3, 3)) / np.sqrt(3))
        return jnp.sum(shading.rgb) + jnp.sum(shading.specular)

    value, gradient = jax.jit(jax.value_and_grad(total))(raw)
    assert np.isfinite(value) and np.isfinite(gradient).all()


def test_an_untrained_surface_reflects_like_a_ball() -> None:
    """Outputs of zero: the normal is the position's direction, and more light is reflected than diffuse."""
    appearance = created(small("reflection", outward=1.0, diffuse_bias=-3.0, specular_bias=-1.5))
    outward = POINTS / np.linalg.norm(POINTS, axis=0)
    material, shading = seen(appearance, untrained(appearance), POINTS, -outward)
    np.testing.assert_allclose(material.normals_pred, outward, atol=1e-6)  # rounding of one division in float32
    assert np.mean(shading.specular) > np.mean(material.diffuse)


@pytest.mark.parametrize("kind", ["reflection", "diffuse"])
def test_an_untrained_table_faces_cameras_above_it(kind: str) -> None:
    appearance = created(small(kind, outward=1.0), Start(towards=(0.0, 0.0, 0.6)))
    table = np.float32([[-0.4, 0.0, 0.4], [0.2, 0.0, -0.2], [-0.55, -0.55, -0.55]])
    material = jax.jit(lambda raw, points: appearance.material(raw, points))(untrained(appearance)[:, :3], table)
    assert (np.asarray(material.normals_pred)[2] > 0).all()


def test_an_untrained_surface_is_as_rough_as_the_configuration_says() -> None:
    appearance = created(small("reflection", roughness_bias=-3.0))
    material = jax.jit(lambda raw, points: appearance.material(raw, points))(untrained(appearance), POINTS)
    np.testing.assert_allclose(material.roughness, np.log1p(np.exp(-3.0)), rtol=1e-6)  # rounding of float32
