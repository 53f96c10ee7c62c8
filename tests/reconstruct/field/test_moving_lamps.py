"""Colours under lamps that move: a whole rig that turns with its lamps sees the same, one without them does not."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets import pose
from reconstruct.config import FieldConfig
from reconstruct.field.appearance import Material, Reflection, Start, create_appearance
from reconstruct.field.lit import Lit
from reconstruct.field.moving_lamps import MovingLamps
from reconstruct.scene.light import Frame, LightFrame
from reconstruct.scene.rays import Rays

FIELD = FieldConfig(bottleneck=2, view_width=16, ide_degree=3)
COUNT = 40


def reflection(kind: Frame) -> Reflection:
    appearance = create_appearance(jax.random.key(0), FIELD, Start(light=LightFrame(kind, distance=2.0)))
    assert isinstance(appearance, Reflection)
    return appearance


def colours(kind: Frame, turn: np.ndarray) -> np.ndarray:
    """Of points before a camera, the whole turned about the origin: diffuse and specular, stacked."""
    appearance = reflection(kind)
    camera = turn @ pose.look_at((2.0, 0.3, 0.6), (0, 0, 0))[:3, :3]
    rng = np.random.default_rng(0)
    in_camera = np.concatenate([rng.uniform(-0.2, 0.2, (COUNT, 2)), np.ones((COUNT, 1))], -1)
    normals = rng.normal(size=(COUNT, 3)) @ turn.T
    rotation = LightFrame(kind, distance=2.0).from_scene(camera)
    light = None if rotation is None else jnp.broadcast_to(jnp.asarray(rotation, jnp.float32), (COUNT, 3, 3))
    f = lambda a: jnp.asarray(a, jnp.float32)  # noqa: E731
    rays = Rays(jnp.zeros((COUNT, 3)), f(in_camera @ camera.T), jnp.full(COUNT, 1e-3), light=light)
    lit = Lit.on(rays, f(rng.uniform(1.5, 2.5, COUNT)))
    raw = jax.random.normal(jax.random.key(1), (appearance.heads + 2, COUNT))
    material = eqx.tree_at(lambda m: m.normals_pred, appearance.material(raw, jnp.zeros((3, COUNT))), f(normals.T))
    material = material if lit is None else appearance.lit(material, lit)
    shading = appearance.shade(material, rays.viewdirs.T, light=lit)
    return np.concatenate([material.diffuse, shading.specular])


ABOUT_Z = Rotation.from_rotvec([0, 0, 1.9]).as_matrix()
ANY = Rotation.from_rotvec([0.5, -1.1, 0.7]).as_matrix()


@pytest.mark.parametrize(
    ("kind", "turn", "same"),
    [("camera", ANY, True), ("turntable", ABOUT_Z, True), ("turntable", ANY, False), ("world", ABOUT_Z, False)],
)
def test_a_rig_that_turns_with_its_lamps_sees_the_same(kind: Frame, turn: np.ndarray, same: bool) -> None:
    difference = np.abs(colours(kind, turn) - colours(kind, np.eye(3)))
    # encodings of the eighth degree amplify float32's roundings of directions
    assert (difference.max() < 2e-5) if same else (difference.max() > 1e-2)


def test_world_has_no_more_weights_than_before() -> None:
    assert reflection("world").moving is None
    plain, moving = (jax.tree.leaves(reflection(kind).view) for kind in ("world", "turntable"))
    assert all((a == b).all() for a, b in zip(plain, moving, strict=True)), "far lamps need no more inputs"
    assert reflection("camera").view.weights[0].shape[1] == plain[0].shape[1] + 3


def test_irradiance_is_positive_about_one_and_has_finite_gradients() -> None:
    lamps = MovingLamps.create(jax.random.key(0), LightFrame("camera", distance=2.0))
    light = Lit(jnp.eye(3)[None].repeat(3, 0), jnp.array([[0.0, 0.3, 0.0], [0.0, 0.0, 0.0], [2.0, 2.0, 0.0]]))
    normals = jnp.array([[0.0, 0.6, 0.0], [0.0, 0.0, 0.0], [-1.0, -0.8, 0.0]])  # the last: no normal, at the lens
    value, gradient = jax.value_and_grad(lambda n: jnp.sum(lamps.irradiance(light, n)))(normals)
    assert np.isfinite(gradient).all() and 2 < value < 25  # of nine values
    assert (lamps.irradiance(light, normals) > 0).all()


def test_a_lit_material_changes_nothing_but_its_diffuse_colour() -> None:
    appearance = reflection("turntable")
    raw = jax.random.normal(jax.random.key(1), (appearance.heads + 2, 4))
    material = appearance.material(raw, jnp.zeros((3, 4)))
    light = Lit(jnp.broadcast_to(jnp.eye(3), (4, 3, 3)), jnp.ones((3, 4)))
    lit = appearance.lit(material, light)
    assert (np.asarray(lit.diffuse) != np.asarray(material.diffuse)).all()
    rest = lambda m: Material(jnp.zeros((3, 4)), m.tint, m.roughness, m.normals_pred, m.bottleneck).stacked()  # noqa: E731
    np.testing.assert_array_equal(rest(lit), rest(material))
