"""Colours under lamps that move: a whole rig that turns with its lamps sees the same, one without them does not."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from koala3d.datasets import pose
from koala3d.reconstruct.config import FieldConfig
from koala3d.reconstruct.field.appearance import Material, Reflection, Start, create_appearance
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.field.moving_lamps import MovingLamps
from koala3d.reconstruct.scene.light import Frame, LightFrame
from koala3d.reconstruct.scene.rays import Rays
from tests import drawn

FIELD = FieldConfig(bottleneck=2, view_width=16, ide_degree=3)
COUNT = 40


def fresh(kind: Frame) -> Reflection:
    appearance = create_appearance(jax.random.key(0), FIELD, Start(light=LightFrame(kind, distance=2.0)))
    assert isinstance(appearance, Reflection)
    return appearance


def reflection(kind: Frame) -> Reflection:
    return drawn.filled(lambda: fresh(kind))


@jax.jit
def shaded(appearance: Reflection, raw: jax.Array, normals: jax.Array, rays: Rays, t: jax.Array) -> jax.Array:
    """Diffuse and specular colour, stacked."""
    lit = Lit.on(rays, t)
    material = eqx.tree_at(lambda m: m.normals_pred, appearance.material(raw, jnp.zeros((3, COUNT))), normals)
    material = material if lit is None else appearance.under_lamps(material, lit)
    shading = appearance.shade(material, rays.viewdirs.T, light=lit)
    return jnp.concatenate([material.diffuse, shading.specular])


def colours(kind: Frame, turn: np.ndarray) -> np.ndarray:
    """Of points before a camera, the whole turned about the origin: diffuse and specular, stacked."""
    appearance = reflection(kind)
    camera = turn @ pose.look_at((2.0, 0.3, 0.6), (0, 0, 0))[:3, :3]
    rng = np.random.default_rng(0)
    in_camera = np.concatenate([rng.uniform(-0.2, 0.2, (COUNT, 2)), np.ones((COUNT, 1))], -1)
    normals = rng.normal(size=(COUNT, 3)) @ turn.T
    rotation = LightFrame(kind, distance=2.0).from_scene(camera)
    light = None if rotation is None else drawn.array(np.broadcast_to(rotation, (COUNT, 3, 3)))
    f = drawn.array
    rays = Rays(f(np.zeros((COUNT, 3))), f(in_camera @ camera.T), f(np.full(COUNT, 1e-3)), light=light)
    raw = drawn.normal(appearance.heads + 2, COUNT, seed=1)
    return np.asarray(shaded(appearance, raw, f(normals.T), rays, f(rng.uniform(1.5, 2.5, COUNT))))


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
    assert fresh("world").moving is None
    plain, moving = (jax.tree.leaves(fresh(kind).view) for kind in ("world", "turntable"))
    for one, other in zip(plain, moving, strict=True):
        np.testing.assert_array_equal(one, other, err_msg="far lamps need no more inputs")
    assert reflection("camera").view.weights[0].shape[1] == plain[0].shape[1] + 3


def test_irradiance_is_positive_about_one_and_has_finite_gradients() -> None:
    lamps = drawn.filled(lambda: MovingLamps.create(jax.random.key(0), LightFrame("camera", distance=2.0)))
    places = drawn.array([[0.0, 0.3, 0.0], [0.0, 0.0, 0.0], [2.0, 2.0, 0.0]])
    light = Lit(drawn.array(np.tile(np.eye(3), (3, 1, 1))), places)
    normals = np.float32([[0.0, 0.6, 0.0], [0.0, 0.0, 0.0], [-1.0, -0.8, 0.0]])  # the last: no normal, at the lens
    irradiance = lambda n: (jnp.sum(found := lamps.irradiance(light, n)), found)  # noqa: E731
    (value, each), gradient = jax.jit(jax.value_and_grad(irradiance, has_aux=True))(normals)
    assert np.isfinite(gradient).all() and 2 < value < 25  # of nine values
    assert (np.asarray(each) > 0).all()


def test_a_lit_material_changes_nothing_but_its_diffuse_colour() -> None:
    appearance = reflection("turntable")
    light = Lit(drawn.array(np.tile(np.eye(3), (4, 1, 1))), drawn.array(np.ones((3, 4))))

    @jax.jit
    def both(raw: jax.Array) -> tuple[Material, Material]:
        material = appearance.material(raw, jnp.zeros((3, 4)))
        return material, appearance.under_lamps(material, light)

    material, lit = jax.tree.map(np.asarray, both(drawn.normal(appearance.heads + 2, 4)))
    assert (lit.diffuse != material.diffuse).all()
    for name in ("tint", "roughness", "normals_pred", "bottleneck"):
        np.testing.assert_array_equal(getattr(lit, name), getattr(material, name))
