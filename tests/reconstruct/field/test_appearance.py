import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reconstruct.config import FieldConfig
from reconstruct.field.appearance import Material, Matte, Reflection, Shading, ViewColour, create_appearance
from reconstruct.field.encodings.directional import ide_channels
from reconstruct.numerics.safe import linear_from_srgb

KINDS = ("reflection", "view", "view_diffuse", "diffuse")


def small(kind: str) -> FieldConfig:
    return FieldConfig(appearance=kind, bottleneck=4, view_width=16, ide_degree=3, view_degree=2)


def some_material(appearance, count: int = 50) -> Material:
    """Heads of random outputs of order one."""
    raw = jax.random.normal(jax.random.key(1), (appearance.heads + 4, count))
    points = jax.random.uniform(jax.random.key(3), (3, count), minval=-1)
    return jax.jit(lambda raw, points: appearance.material(raw, points))(raw, points)


def some_viewdirs(count: int = 50) -> jax.Array:
    viewdirs = jax.random.normal(jax.random.key(2), (3, count))
    return viewdirs / jnp.linalg.norm(viewdirs, axis=0)


def shade(appearance, material: Material, viewdirs: jax.Array) -> Shading:
    return jax.jit(lambda m, d: appearance.shade(m, d))(material, viewdirs)


@pytest.fixture(params=KINDS)
def appearance(request: pytest.FixtureRequest):
    return create_appearance(jax.random.key(0), small(request.param))


def test_a_material_is_in_range_and_stacks(appearance) -> None:
    material = some_material(appearance)
    assert 0 <= material.diffuse.min() <= material.diffuse.max() < 1
    assert 0 <= material.tint.min() <= material.tint.max() <= 1
    assert material.roughness.min() >= 0
    length = np.linalg.norm(material.normals_pred, axis=0)
    np.testing.assert_allclose(length, 1.0 if appearance.predicts_normals else 0.0, atol=1e-5)
    again = Material.unstacked(material.stacked())
    for name in ("diffuse", "tint", "roughness", "normals_pred", "bottleneck"):
        np.testing.assert_array_equal(getattr(again, name), getattr(material, name))


def test_colour_is_the_curve_of_diffuse_plus_specular(appearance) -> None:
    """All appearances: linear parts add up to what sRGB shows, within float32 and the padding of 0.001."""
    material = some_material(appearance)
    shading = shade(appearance, material, some_viewdirs())
    linear = np.asarray(material.diffuse + shading.specular, np.float64)
    curve = np.where(linear > 0.0031308, 1.055 * linear ** (1 / 2.4) - 0.055, 12.92 * linear)
    np.testing.assert_allclose(shading.rgb, np.clip(curve, 0, 1) * 1.002 - 0.001, atol=1e-5)
    assert (shading.specular <= material.tint).all()


def test_what_is_matte_looks_alike_from_all_sides() -> None:
    appearance = create_appearance(jax.random.key(0), small("diffuse"))
    material, viewdirs = some_material(appearance), some_viewdirs()
    np.testing.assert_array_equal(appearance.shade(material, viewdirs).rgb, appearance.shade(material, -viewdirs).rgb)
    assert not appearance.shade(material, viewdirs).specular.any() and not jax.tree.leaves(appearance)


def test_which_parts_each_has() -> None:
    made = {kind: create_appearance(jax.random.key(0), small(kind)) for kind in KINDS}
    assert isinstance(made["reflection"], Reflection) and isinstance(made["view"], ViewColour)
    assert isinstance(made["diffuse"], Matte)
    assert [made[kind].has_diffuse for kind in KINDS] == [True, False, True, True]
    assert [made[kind].heads for kind in KINDS] == [10, 0, 3, 6]
    assert (np.asarray(some_material(made["view"]).diffuse) == 0).all()


def test_view_colour_depends_on_the_direction_alone_and_not_on_normals() -> None:
    appearance = create_appearance(jax.random.key(0), small("view"))
    material, viewdirs = some_material(appearance), some_viewdirs()
    shading = appearance.shade(material, viewdirs)
    turned = appearance.shade(material, viewdirs, normals=-viewdirs)
    np.testing.assert_array_equal(shading.rgb, turned.rgb)
    assert np.abs(appearance.shade(material, -viewdirs).rgb - shading.rgb).max() > 1e-3
    np.testing.assert_allclose(linear_from_srgb((shading.rgb + 0.001) / 1.002), shading.specular, atol=1e-5)


def test_reflection_follows_the_law_of_reflection(monkeypatch: pytest.MonkeyPatch) -> None:
    """Looking down at 45 degrees onto a floor one sees what lies ahead and up at 45 degrees."""
    seen = []
    monkeypatch.setattr(
        "reconstruct.field.appearance.integrated_directional_encoding",
        lambda d, r, n: seen.append(d) or jnp.zeros((ide_channels(n), 1)),
    )
    appearance = create_appearance(jax.random.key(0), small("reflection"))
    half = np.sqrt(0.5)
    floor = jnp.array([[0.0], [0.0], [1.0]])
    appearance.shade(some_material(appearance, 1), jnp.array([[half], [0.0], [-half]]), normals=floor)
    np.testing.assert_allclose(seen[0], [[half], [0], [half]], atol=1e-6)


def test_gradients_are_finite(appearance) -> None:
    """At raw outputs that saturate every head, zeros and large values included."""
    raw = jnp.concatenate(
        [
            jnp.zeros((appearance.heads + 4, 1)),
            jnp.full((appearance.heads + 4, 1), 80.0),
            jnp.full((appearance.heads + 4, 1), -80.0),
        ],
        1,
    )

    def total(raw: jax.Array) -> jax.Array:
        shading = appearance.shade(appearance.material(raw, jnp.zeros((3, 3))), jnp.ones((3, 3)) / np.sqrt(3))
        return jnp.sum(shading.rgb) + jnp.sum(shading.specular)

    value, gradient = jax.jit(jax.value_and_grad(total))(raw)
    assert np.isfinite(value) and np.isfinite(gradient).all()


def test_an_untrained_surface_reflects_like_a_ball() -> None:
    """Outputs of zero: the normal is the position's direction, and more light is reflected than diffuse."""
    config = small("reflection").model_copy(update={"outward": 1.0, "diffuse_bias": -3.0, "specular_bias": -1.5})
    appearance = create_appearance(jax.random.key(0), config)
    points = jax.random.normal(jax.random.key(4), (3, 50))
    material = appearance.material(jnp.zeros((appearance.heads + 4, 50)), points)
    outward = points / jnp.linalg.norm(points, axis=0)
    np.testing.assert_allclose(material.normals_pred, outward, atol=1e-6)  # rounding of one division in float32
    assert appearance.shade(material, -outward).specular.mean() > material.diffuse.mean()


@pytest.mark.parametrize("kind", ["reflection", "diffuse"])
def test_an_untrained_table_faces_cameras_above_it(kind: str) -> None:
    config = small(kind).model_copy(update={"outward": 1.0, "towards": (0.0, 0.0, 0.6)})
    appearance = create_appearance(jax.random.key(0), config)
    table = jnp.array([[-0.4, 0.0, 0.4], [0.2, 0.0, -0.2], [-0.55, -0.55, -0.55]])
    assert (appearance.material(jnp.zeros((appearance.heads + 4, 3)), table).normals_pred[2] > 0).all()


def test_what_is_around_the_box_begins_matte() -> None:
    """Inside the box nothing changes; a ramp's width beside it, most light is diffuse; between, the change grows evenly."""
    config = small("reflection").model_copy(update={"diffuse_bias": -3.0, "specular_bias": -1.5})
    around = create_appearance(jax.random.key(0), config.model_copy(update={"matte_around": 3.5, "half_box": (0.5, 0.4, 0.6)}))
    plain = create_appearance(jax.random.key(0), config)
    raw = jnp.zeros((plain.heads + 4, 4))
    points = jnp.array(
        [[0.45, -0.6, 0.7, -1.9], [-0.35, 0.0, 0.0, 0.0], [0.55, 0.0, 0.0, 0.5]]
    )  # inside, half way, outside twice
    one, other = around.material(raw, points), plain.material(raw, points)
    np.testing.assert_array_equal(one.stacked()[:, 0], other.stacked()[:, 0])
    raised = np.log(one.diffuse / (1 - one.diffuse))[0] - np.log(other.diffuse / (1 - other.diffuse))[0]
    np.testing.assert_allclose(raised, [0, 1.75, 3.5, 3.5], atol=1e-5)  # float32 near 3.5
    viewdirs = jnp.tile(jnp.array([[0.0], [0.0], [-1.0]]), 4)
    shading = around.shade(one, viewdirs)
    assert (shading.specular[:, 2:] < 0.05 * one.diffuse[:, 2:]).all() and (shading.specular[:, 0] > one.diffuse[:, 0]).all()


def test_an_untrained_surface_is_as_rough_as_the_configuration_says() -> None:
    config = small("reflection").model_copy(update={"roughness_bias": -3.0})
    appearance = create_appearance(jax.random.key(0), config)
    material = appearance.material(jnp.zeros((appearance.heads + 4, 2)), jnp.ones((3, 2)))
    np.testing.assert_allclose(material.roughness, np.log1p(np.exp(-3.0)), rtol=1e-6)  # rounding of float32
