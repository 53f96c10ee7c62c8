"""Reflected rays through the scene: a mirror on the floor beside a painted wall shows the wall, by the law of reflection."""

import functools
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging.images import linear_from_srgb
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.field.appearance import Material
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.field.near import Near
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.rendering.casting import ROUGH, Casting
from koala3d.reconstruct.rendering.model import Model, Rendered, render
from koala3d.reconstruct.rendering.pictures import Renderer
from koala3d.reconstruct.sampling.occupancy import Occupancy, cell_centres
from koala3d.reconstruct.sampling.samples import cloud_of
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.frustum import Frustum
from koala3d.reconstruct.scene.rays import Normalisation, Rays
from tests import drawn

WALL, COUNT, SHARPNESS = 0.5, 40, 0.004
FACTS = SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.1, 6.0))
ROUNDING = 1e-6
"""Between two programs: some ulp of light of order one."""
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
    return load_config(overrides=[*small, "field.ide_degree=2", f"light.cast={cast}", *more])


@functools.cache
def corner(roughness: float = 1e-4, tint: float = 1.0) -> Model:
    """The model of a corner, whose grid knows what is solid."""
    model = Model.create(jax.random.key(0), settings(), FACTS)
    field, grid = model.field, model.sampler.grid
    parts = (field.encoding, field.spatial, field.appearance, field.density_bias, field.deferred)
    x, _, z = cell_centres(64, 1.0).T
    occupied = (np.abs(z) < 2 / 64) | (np.abs(x - WALL) < 2 / 64)
    grid = eqx.tree_at(lambda g: g.density, grid, drawn.array(np.where(occupied, 3000.0, 0.0)))
    grid = jax.jit(Occupancy.with_occupied)(grid, occupied)
    solid = Corner(*parts, drawn.array(roughness), drawn.array(tint))
    return replace(model, field=solid, sampler=replace(model.sampler, grid=grid))


def some_rays() -> tuple[Rays, np.ndarray]:
    """Down onto the mirror and on towards the wall or, the second half, past it; (n, 3) where they then meet the wall's plane."""
    rng = np.random.default_rng(0)
    target = np.stack([rng.uniform(-0.2, 0.2, COUNT), rng.uniform(-0.4, 0.4, COUNT), np.zeros(COUNT)], -1)
    towards = np.stack([rng.uniform(0.9, 1.3, COUNT), rng.uniform(-0.2, 0.2, COUNT), -np.ones(COUNT)], -1)
    towards[~TOWARDS, 0], towards[~TOWARDS, 1] = 0.04, rng.uniform(0.5, 0.9, COUNT // 2)
    reflected = towards * [1, 1, -1]
    ends = target + reflected * ((WALL - target[:, :1]) / reflected[:, :1])
    return Rays(*map(drawn.array, (target - 2.5 * towards, towards, np.full(COUNT, 1e-3)))), ends


def _look(model: Model, cast: bool) -> Rendered:
    rays, _ = some_rays()
    found = model.sampler.look(rays)
    cloud = cloud_of(rays, found.samples, space=FACTS.normalisation.space, footprint=found.footprint)
    return render(model.field, rays, found.samples, cloud, model.caster if cast else None)[0]


_LOOK = jax.jit(_look, static_argnums=1)


@functools.cache
def shown(roughness: float = 1e-4, tint: float = 1.0, *, share: float | None = None, cast: bool = True) -> Rendered:
    """What is seen of a corner."""
    model = corner(roughness, tint)
    model = model if share is None else model.casting_with(drawn.array(share))
    return jax.tree.map(np.asarray, _LOOK(model, cast))


def test_a_mirror_shows_the_wall_beside_it() -> None:
    seen, (_, ends) = shown(), some_rays()
    assert seen.opacity.min() > 0.99 and (np.abs(ends[TOWARDS]) < 0.95).all(), "mirrors, beside the wall"
    assert (ends[~TOWARDS, 2] > 1).all(), "and others that show nothing"
    # a step of 0.03 along the reflected ray moves what is seen by less than 0.02; the paint changes by up to 1.5 per unit
    np.testing.assert_allclose(seen.specular[TOWARDS], painted(ends[TOWARDS]), atol=0.03)
    np.testing.assert_allclose(linear_from_srgb((seen.rgb + 0.001) / 1.002)[TOWARDS], seen.specular[TOWARDS], atol=0.01)
    assert np.abs(shown(cast=False).specular - seen.specular)[TOWARDS].max() > 0.1, "the light from afar differs"


def test_where_reflections_leave_the_scene_the_light_comes_from_afar() -> None:
    np.testing.assert_allclose(shown().specular[~TOWARDS], shown(cast=False).specular[~TOWARDS], atol=ROUNDING)


def test_pictures_cast_the_same_rays() -> None:
    model, (rays, _) = corner(), some_rays()
    lists = np.asarray(rays.origins), np.asarray(rays.directions), np.asarray(rays.radii)
    found = Renderer(FACTS.normalisation).rays(model, *lists)
    np.testing.assert_allclose(found["specular"], shown().specular, atol=2e-3)  # what is hidden is left out there


@pytest.mark.parametrize(("change", "same"), [({"tint": 0.01}, True), ({"roughness": 2.1 * ROUGH}, True), ({}, False)])
def test_only_mirrors_cast(change: dict[str, float], same: bool) -> None:
    difference = np.abs(shown(**change).specular - shown(**change, cast=False).specular).max()
    assert difference < ROUNDING if same else difference > 0.1


def test_the_share_blends_near_light_with_that_from_afar() -> None:
    whole, none, half = shown().specular, shown(share=0.0).specular, shown(share=0.5).specular
    np.testing.assert_allclose(none, shown(cast=False).specular, atol=ROUNDING)
    np.testing.assert_allclose(half, (whole + none) / 2, atol=1e-5)


def near_of(model: Model, rays: Rays, material: Material, opacity: jax.Array) -> Near:
    assert model.caster is not None
    return model.caster.near(model.field, rays, material, jnp.full(COUNT, 2.5), opacity)


def some_material(normals: np.ndarray) -> Material:
    ones = np.ones((3, COUNT))
    return Material(*map(drawn.array, (0 * ones, ones, 0.01 * ones[:1], normals, ones[:0])))


def test_no_gradient_goes_to_what_is_met() -> None:
    """Not to the field, nor through the mirror's normals; the tint that it is multiplied by has one."""
    model, (rays, _) = Model.create(jax.random.key(0), settings("field.density_bias=3"), FACTS), some_rays()
    learned, held = model.split()
    up = np.tile([[0.0], [0.0], [1.0]], COUNT)

    def light(learned: Model, material: Material) -> jax.Array:
        near = near_of(eqx.combine(learned, held), rays, material, jnp.ones(COUNT))
        return jnp.sum(near.before(material.tint))

    slopes = jax.jit(jax.grad(light, (0, 1)))(learned, some_material(up))
    slopes = jax.tree.map(np.asarray, slopes)
    others = [*jax.tree.leaves(slopes[0]), slopes[1].normals_pred, slopes[1].roughness, slopes[1].diffuse]
    assert not any(leaf.any() for leaf in others)
    tint = slopes[1].tint  # what the light from afar is multiplied by
    assert (tint >= 0).all() and tint.min() < 0.9 and tint.max() <= 1, "some of it is hidden by what is met"


def test_rays_without_surface_or_normal_are_finite() -> None:
    """No normal, no opacity, a normal along the ray, a surface outside the scene."""
    model, (rays, _) = corner(), some_rays()
    index, directions = np.arange(COUNT), np.asarray(rays.directions)
    viewdirs = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    far = drawn.array(np.where(index[:, None] < 30, rays.origins, 1e4))
    normals = np.stack([0 * index, 0 * index, index >= 10])
    normals = np.where((index >= 20) & (index < 25), -viewdirs.T, normals)
    opacity = drawn.array((index < 5) | (index >= 15))

    def light(material: Material) -> jax.Array:
        near = near_of(model, replace(rays, origins=far), material, opacity)
        return jnp.sum(model.field.shade(material, jnp.asarray(viewdirs.T), near=near).rgb)

    with jax.debug_nans(True):
        value, slopes = jax.jit(jax.value_and_grad(light))(some_material(normals))
    assert np.isfinite(value) and all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes))


def created(*more: str, cast: int = 8, facts: SceneFacts = FACTS) -> Model:
    """A model with shapes in place of its arrays."""
    return eqx.filter_eval_shape(lambda: Model.create(jax.random.key(0), settings(*more, cast=cast), facts))


def test_off_is_as_if_it_were_not_there() -> None:
    on, off = (created("light.parallax_learned=false", cast=n) for n in (8, 0))
    assert off.casting is None and off.caster is None and off.field.appearance.parallax is None
    assert on.casting is not None and on.casting.samples == 8
    assert jax.tree.structure(replace(on, casting=None)) == jax.tree.structure(off)
    assert on.split()[0].casting.cast_share is None, "it is not learned"
    assert created("field.appearance=diffuse").casting is None


def test_cameras_that_share_a_frustum_cast_nothing() -> None:
    """Reflected rays leave it."""
    shared = Frustum(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, -3.0), 0.8, 0.4, 1.5, 6.0)
    facts = SceneFacts(replace(FACTS.normalisation, bounded=False, frustum=shared))
    assert created(facts=facts).casting is None


@pytest.mark.parametrize("change", ["field.shading=sample", "sampler.kind=proposal"])
def test_what_cannot_cast_says_so(change: str) -> None:
    sampler = created(change, cast=0).sampler
    with pytest.raises(UsageError, match="reflected rays cannot be cast"):
        Casting.of(settings(change), sampler)
