"""Reflected rays through the scene: a mirror on the floor beside a painted wall shows the wall, by the law of reflection."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from datasets.core.errors import UsageError
from reconstruct.config import Config
from reconstruct.field.appearance import Material
from reconstruct.field.cloud import Cloud
from reconstruct.field.field import Field
from reconstruct.field.near import Near
from reconstruct.models import load_config
from reconstruct.numerics.safe import linear_from_srgb
from reconstruct.rendering.casting import ROUGH, Casting
from reconstruct.rendering.model import Model, Rendered, render
from reconstruct.rendering.pictures import Renderer
from reconstruct.sampling.occupancy import cell_centres
from reconstruct.sampling.samples import cloud_of
from reconstruct.scene.facts import SceneFacts
from reconstruct.scene.frustum import Frustum
from reconstruct.scene.rays import Normalisation, Rays

WALL, COUNT, SHARPNESS = 0.5, 40, 0.004
FACTS = SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.1, 6.0))
TOWARDS = np.arange(COUNT) < COUNT // 2
"""Rays whose reflections meet the wall."""


class Corner(Field):
    """A mirror below z = 0 without a colour of its own, and a matte wall behind x = WALL."""

    roughness: jax.Array
    tint: jax.Array

    def __call__(self, cloud: Cloud) -> tuple[jax.Array, Material]:
        """Of points, whatever their extent."""
        x, y, z = cloud.points
        inside = jnp.maximum(jax.nn.sigmoid(-z / SHARPNESS), jax.nn.sigmoid((x - WALL) / SHARPNESS))
        wall, some = x > WALL - 0.05, jnp.ones_like(x)
        colour = jnp.stack([0.4 + 0.3 * jnp.sin(4 * y), 0.4 + 0.3 * jnp.cos(5 * z), 0.3 * some])
        outward = jnp.where(wall, jnp.array([[-1.0], [0.0], [0.0]]), jnp.array([[0.0], [0.0], [1.0]]))
        tint = jnp.where(wall, 0.0, self.tint) * jnp.stack([some] * 3)
        bottleneck = jnp.zeros((0, x.shape[0]))
        return 3000 * inside, Material(jnp.where(wall, colour, 0.0), tint, self.roughness * some[None], outward, bottleneck)


def painted(points: np.ndarray) -> np.ndarray:
    """(n, 3) diffuse colour of the wall."""
    _, y, z = points.T
    return np.stack([0.4 + 0.3 * np.sin(4 * y), 0.4 + 0.3 * np.cos(5 * z), np.full_like(y, 0.3)], -1)


def settings(*more: str, cast: int = 8) -> Config:
    small = ["encoding.levels=2", "encoding.log2_size=8", "field.spatial_width=8", "field.view_width=8", "sampler.grid=64"]
    return load_config(overrides=[*small, f"light.cast={cast}", *more])


def corner(roughness: float = 1e-4, tint: float = 1.0) -> Model:
    """The model of a corner, whose grid knows what is solid."""
    model = Model.create(jax.random.key(0), settings(), FACTS)
    field, grid = model.field, model.sampler.grid
    parts = (field.encoding, field.spatial, field.appearance, field.density_bias, field.deferred)
    x, _, z = cell_centres(64, 1.0).T
    occupied = jnp.asarray((np.abs(z) < 2 / 64) | (np.abs(x - WALL) < 2 / 64))
    grid = eqx.tree_at(lambda g: g.density, grid, jnp.where(occupied, 3000.0, 0.0)).with_occupied(occupied)
    solid = Corner(*parts, jnp.asarray(roughness), jnp.asarray(tint))
    return replace(model, field=solid, sampler=replace(model.sampler, grid=grid))


def some_rays() -> tuple[Rays, np.ndarray]:
    """Down onto the mirror and on towards the wall or, the second half, past it; (n, 3) where they then meet the wall's plane."""
    rng = np.random.default_rng(0)
    target = np.stack([rng.uniform(-0.2, 0.2, COUNT), rng.uniform(-0.4, 0.4, COUNT), np.zeros(COUNT)], -1)
    towards = np.stack([rng.uniform(0.9, 1.3, COUNT), rng.uniform(-0.2, 0.2, COUNT), -np.ones(COUNT)], -1)
    towards[~TOWARDS, 0], towards[~TOWARDS, 1] = 0.04, rng.uniform(0.5, 0.9, COUNT // 2)
    reflected = towards * [1, 1, -1]
    ends = target + reflected * ((WALL - target[:, :1]) / reflected[:, :1])
    f = lambda a: jnp.asarray(a, jnp.float32)  # noqa: E731
    return Rays(f(target - 2.5 * towards), f(towards), jnp.full(COUNT, 1e-3)), ends


def _look(model: Model, cast: bool) -> Rendered:
    rays, _ = some_rays()
    found = model.sampler.look(rays)
    cloud = cloud_of(rays, found.samples, space=FACTS.normalisation.space, footprint=found.footprint)
    return render(model.field, rays, found.samples, cloud, model.caster if cast else None)[0]


UNOPTIMISED = {"xla_backend_optimization_level": 0}
_LOOK = jax.jit(_look, static_argnums=1, compiler_options=UNOPTIMISED)


def shown(model: Model, *, cast: bool = True) -> Rendered:
    return _LOOK(model, cast)


def test_a_mirror_shows_the_wall_beside_it() -> None:
    seen, (_, ends) = shown(corner()), some_rays()
    assert np.asarray(seen.opacity).min() > 0.99 and (np.abs(ends[TOWARDS]) < 0.95).all(), "mirrors, beside the wall"
    assert (ends[~TOWARDS, 2] > 1).all(), "and others that show nothing"
    # a step of 0.03 along the reflected ray moves what is seen by less than 0.02; the paint changes by up to 1.5 per unit
    np.testing.assert_allclose(seen.specular[TOWARDS], painted(ends[TOWARDS]), atol=0.03)
    np.testing.assert_allclose(linear_from_srgb((seen.rgb + 0.001) / 1.002)[TOWARDS], seen.specular[TOWARDS], atol=0.01)
    assert np.abs(shown(corner(), cast=False).specular - seen.specular)[TOWARDS].max() > 0.1, "the light from afar differs"


def test_where_reflections_leave_the_scene_the_light_comes_from_afar() -> None:
    np.testing.assert_array_equal(shown(corner()).specular[~TOWARDS], shown(corner(), cast=False).specular[~TOWARDS])


def test_pictures_cast_the_same_rays() -> None:
    model, (rays, _) = corner(), some_rays()
    lists = np.asarray(rays.origins), np.asarray(rays.directions), np.asarray(rays.radii)
    found = Renderer(FACTS.normalisation).rays(model, *lists)
    np.testing.assert_allclose(found["specular"], shown(model).specular, atol=2e-3)  # what is hidden is left out there


@pytest.mark.parametrize(("change", "same"), [({"tint": 0.01}, True), ({"roughness": 2.1 * ROUGH}, True), ({}, False)])
def test_only_mirrors_cast(change: dict[str, float], same: bool) -> None:
    model = corner(**change)
    assert bool((shown(model).specular == shown(model, cast=False).specular).all()) == same


def test_the_share_blends_near_light_with_that_from_afar() -> None:
    model = corner()
    whole, none = shown(model).specular, shown(model.casting_with(jnp.zeros(()))).specular
    np.testing.assert_array_equal(none, shown(model, cast=False).specular)
    half = shown(model.casting_with(jnp.asarray(0.5))).specular
    np.testing.assert_allclose(half, (whole + none) / 2, atol=1e-5)


def near_of(model: Model, rays: Rays, material: Material, opacity: jax.Array) -> Near:
    assert model.caster is not None
    return model.caster.near(model.field, rays, material, jnp.full(COUNT, 2.5), opacity)


def some_material(normals: jax.Array) -> Material:
    ones = jnp.ones((3, COUNT))
    return Material(0 * ones, ones, 0.01 * ones[:1], normals, jnp.zeros((0, COUNT)))


def test_no_gradient_goes_to_what_is_met() -> None:
    """Not to the field, nor through the mirror's normals; the tint that it is multiplied by has one."""
    model, (rays, _) = Model.create(jax.random.key(0), settings("field.density_bias=3"), FACTS), some_rays()
    learned, held = model.split()
    up = jnp.broadcast_to(jnp.array([[0.0], [0.0], [1.0]]), (3, COUNT))

    def light(learned: Model, material: Material) -> jax.Array:
        near = near_of(eqx.combine(learned, held), rays, material, jnp.ones(COUNT))
        return jnp.sum(near.before(material.tint))

    slopes = jax.jit(jax.grad(light, (0, 1)), compiler_options=UNOPTIMISED)(learned, some_material(up))
    others = [*jax.tree.leaves(slopes[0]), slopes[1].normals_pred, slopes[1].roughness, slopes[1].diffuse]
    assert all((leaf == 0).all() for leaf in others)
    tint = np.asarray(slopes[1].tint)  # what the light from afar is multiplied by
    assert (tint >= 0).all() and tint.min() < 0.9 and tint.max() <= 1, "some of it is hidden by what is met"


def test_rays_without_surface_or_normal_are_finite() -> None:
    """No normal, no opacity, a normal along the ray, a surface outside the scene."""
    model, (rays, _) = corner(), some_rays()
    far = rays.origins.at[30:].set(1e4)
    normals = jnp.zeros((3, COUNT)).at[2, 10:].set(1.0).at[:, 20:25].set(-rays.viewdirs[20:25].T)
    opacity = jnp.ones(COUNT).at[5:15].set(0.0)

    def light(material: Material) -> jax.Array:
        near = near_of(model, replace(rays, origins=far), material, opacity)
        return jnp.sum(model.field.shade(material, rays.viewdirs.T, near=near).rgb)

    with jax.debug_nans(True):
        value, slopes = jax.jit(jax.value_and_grad(light), compiler_options=UNOPTIMISED)(some_material(normals))
    assert np.isfinite(value) and all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes))


def test_off_is_as_if_it_were_not_there() -> None:
    on, off = (Model.create(jax.random.key(0), settings("light.parallax_learned=false", cast=n), FACTS) for n in (8, 0))
    assert off.casting is None and off.caster is None and off.field.appearance.parallax is None
    assert on.casting is not None and on.casting.samples == 8
    assert jax.tree.structure(replace(on, casting=None)) == jax.tree.structure(off)
    assert on.split()[0].casting.cast_share is None, "it is not learned"
    assert Model.create(jax.random.key(0), settings("field.appearance=diffuse"), FACTS).casting is None


def test_cameras_that_share_a_frustum_cast_nothing() -> None:
    """Reflected rays leave it."""
    shared = Frustum(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, -3.0), 0.8, 0.4, 1.5, 6.0)
    facts = SceneFacts(replace(FACTS.normalisation, bounded=False, frustum=shared))
    assert Model.create(jax.random.key(0), settings(), facts).casting is None


@pytest.mark.parametrize("change", ["field.shading=sample", "sampler.kind=proposal"])
def test_what_cannot_cast_says_so(change: str) -> None:
    sampler = Model.create(jax.random.key(0), settings(change, cast=0), FACTS).sampler
    with pytest.raises(UsageError, match="reflected rays cannot be cast"):
        Casting.of(settings(change), sampler)
