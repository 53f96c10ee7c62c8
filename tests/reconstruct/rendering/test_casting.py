"""Reflected rays through the scene: a mirror on the floor beside a painted wall shows the wall, where the law of reflection says."""

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
from reconstruct.models import load_config
from reconstruct.numerics.compiling import jit
from reconstruct.numerics.safe import linear_from_srgb
from reconstruct.rendering.casting import ROUGH, Casting
from reconstruct.rendering.model import Model, Rendered, render
from reconstruct.rendering.pictures import Renderer
from reconstruct.sampling.occupancy import cell_centres
from reconstruct.sampling.samples import cloud_of
from reconstruct.scene.facts import SceneFacts
from reconstruct.scene.rays import Normalisation, Rays

WALL, COUNT, SHARPNESS = 0.5, 40, 0.004
FACTS = SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.1, 6.0))


def painted(points: np.ndarray) -> np.ndarray:
    """(3, n) diffuse colour of the wall."""
    x, y, z = points
    return np.stack([0.4 + 0.3 * np.sin(4 * y), 0.4 + 0.3 * np.cos(5 * z), 0.3 + 0 * x])


class Corner(Field):
    """A mirror below z = 0, without a light of its own, and a matte wall behind x = WALL."""

    roughness: float = eqx.field(static=True, default=1e-4)
    tint: float = eqx.field(static=True, default=1.0)

    def __call__(self, cloud: Cloud) -> tuple[jax.Array, Material]:
        """Of points, whatever their extent."""
        x, y, z = cloud.points
        inside = jnp.maximum(jax.nn.sigmoid(-z / SHARPNESS), jax.nn.sigmoid((x - WALL) / SHARPNESS))
        wall, some = x > WALL - 0.05, jnp.ones_like(x)
        colour = jnp.stack([0.4 + 0.3 * jnp.sin(4 * y), 0.4 + 0.3 * jnp.cos(5 * z), 0.3 * some])
        outward = jnp.where(wall, jnp.array([[-1.0], [0.0], [0.0]]), jnp.array([[0.0], [0.0], [1.0]]))
        tint = jnp.where(wall, 0.0, self.tint) * jnp.stack([some] * 3)
        roughness = jnp.full_like(x, self.roughness)[None]
        return 3000 * inside, Material(jnp.where(wall, colour, 0.0), tint, roughness, outward, jnp.zeros((0, x.shape[0])))


def settings(*more: str) -> Config:
    small = ["encoding.levels=2", "encoding.log2_size=8", "field.spatial_width=8", "field.view_width=8", "sampler.grid=64"]
    return load_config(overrides=[*small, "light.cast=8", *more])


def corner(roughness: float = 1e-4, tint: float = 1.0, config: Config | None = None) -> Model:
    """The model of a corner, whose grid knows what is solid."""
    model = Model.create(jax.random.key(0), config or settings(), FACTS)
    field, grid = model.field, model.sampler.grid
    solid = Corner(field.encoding, field.spatial, field.appearance, field.density_bias, field.deferred, roughness, tint)
    x, _, z = cell_centres(64, 1.0).T
    occupied = jnp.asarray((np.abs(z) < 2 / 64) | (np.abs(x - WALL) < 2 / 64))
    grid = eqx.tree_at(lambda g: g.density, grid, jnp.where(occupied, 3000.0, 0.0)).with_occupied(occupied)
    return replace(model, field=solid, sampler=replace(model.sampler, grid=grid))


def some_rays() -> tuple[Rays, np.ndarray, np.ndarray]:
    """Down onto the mirror, then towards the wall and, of the second half, away from it; where they meet the mirror, and
    where their reflections meet the wall's plane."""
    rng = np.random.default_rng(0)
    target = np.stack([rng.uniform(-0.5, 0.2, COUNT), rng.uniform(-0.5, 0.5, COUNT), np.zeros(COUNT)], -1)
    towards = np.stack([rng.uniform(0.7, 1.2, COUNT), rng.uniform(-0.2, 0.2, COUNT), -np.ones(COUNT)], -1)
    towards[COUNT // 2 :, 0] *= -1
    origins, reflected = target - 2.5 * towards, towards * [1, 1, -1]
    ends = target + reflected * ((WALL - target[:, :1]) / reflected[:, :1])
    f = lambda a: jnp.asarray(a, jnp.float32)  # noqa: E731
    return Rays(f(origins), f(towards), jnp.full(COUNT, 1e-3)), target, ends


def shown(model: Model, *, cast: bool = True) -> Rendered:
    rays, *_ = some_rays()

    def look(model: Model) -> Rendered:
        found = model.sampler.look(rays)
        cloud = cloud_of(rays, found.samples, space=FACTS.normalisation.space, footprint=found.footprint)
        return render(model.field, rays, found.samples, cloud, model.caster if cast else None)[0]

    return jit(look)(model)


TOWARDS = np.arange(COUNT) < COUNT // 2


def test_a_mirror_shows_the_wall_beside_it() -> None:
    seen, (_, _, ends) = shown(corner()), some_rays()
    assert np.asarray(seen.opacity).min() > 0.99 and (ends[TOWARDS, 2] < 1).all(), "mirrors before the wall"
    # steps of 0.02 along the reflected ray place the wall; the paint changes by up to 1.5 per unit
    np.testing.assert_allclose(seen.specular[TOWARDS], painted(ends[TOWARDS].T).T, atol=0.03)
    np.testing.assert_allclose(linear_from_srgb((seen.rgb + 0.001) / 1.002)[TOWARDS], seen.specular[TOWARDS], atol=0.01)
    assert np.abs(shown(corner(), cast=False).specular - seen.specular)[TOWARDS].max() > 0.1, "the light from afar differs"


def test_where_reflections_leave_the_scene_the_light_comes_from_afar() -> None:
    np.testing.assert_array_equal(shown(corner()).specular[~TOWARDS], shown(corner(), cast=False).specular[~TOWARDS])


def test_pictures_cast_the_same_rays() -> None:
    model, (rays, *_) = corner(), some_rays()
    lists = np.asarray(rays.origins), np.asarray(rays.directions), np.asarray(rays.radii)
    found = Renderer(FACTS.normalisation).rays(model, *lists)
    np.testing.assert_allclose(found["specular"], shown(model).specular, atol=2e-3)  # what is hidden is left out there


@pytest.mark.parametrize(("change", "same"), [({"tint": 0.01}, True), ({"roughness": 2 * ROUGH}, True), ({}, False)])
def test_only_mirrors_cast(change: dict[str, float], same: bool) -> None:
    model = corner(**change)
    assert bool((shown(model).specular == shown(model, cast=False).specular).all()) == same


def test_the_share_blends_near_light_with_that_from_afar() -> None:
    model = corner()
    whole, none = shown(model).specular, shown(model.casting_with(jnp.zeros(()))).specular
    np.testing.assert_array_equal(none, shown(model, cast=False).specular)
    half = shown(model.casting_with(jnp.asarray(0.5))).specular
    np.testing.assert_allclose(half, (whole + none) / 2, atol=1e-5)


def test_no_gradient_goes_to_what_is_met() -> None:
    """Of the wall nothing but its mirror image is seen: its colours, from the field's parameters, have none; tint has."""
    config = settings("field.density_bias=3")
    model = Model.create(jax.random.key(0), config, FACTS)
    rays, *_ = some_rays()

    def light(learned: Model, held: Model, cast: bool) -> jax.Array:
        model = eqx.combine(learned, held)
        found = model.sampler.look(rays)
        cloud = cloud_of(rays, found.samples, space=FACTS.normalisation.space, footprint=found.footprint)
        rendered, _ = render(model.field, rays, found.samples, cloud, model.caster if cast else None)
        return jnp.sum(rendered.rgb)

    value, slopes = jax.jit(jax.value_and_grad(light), static_argnums=2)(*model.split(), True)
    assert np.isfinite(value) and all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes))
    assert slopes.casting.cast_share is None and np.abs(slopes.field.spatial.weights[-1]).max() > 0
    near = lambda m: eqx.tree_at(lambda m: m.casting, m, None)  # noqa: E731
    plain = jax.grad(light)(near(model.split()[0]), near(model.split()[1]), False)
    assert jax.tree.structure(plain.field) == jax.tree.structure(slopes.field)


def test_blank_models_have_finite_gradients() -> None:
    """No density, no normals: nothing to reflect."""
    model = jax.tree.map(lambda leaf: jnp.zeros_like(leaf) if eqx.is_inexact_array(leaf) else leaf, corner().split()[0])
    held = corner().split()[1]
    rays, *_ = some_rays()

    def light(learned: Model) -> jax.Array:
        model = eqx.combine(learned, held)
        found = model.sampler.look(rays)
        cloud = cloud_of(rays, found.samples, space=FACTS.normalisation.space, footprint=found.footprint)
        field = Field(*(getattr(model.field, name) for name in ("encoding", "spatial", "appearance", "density_bias", "deferred")))
        return jnp.sum(render(field, rays, found.samples, cloud, model.caster)[0].rgb)

    with jax.debug_nans(True):
        value, slopes = jax.value_and_grad(light)(model)
    assert np.isfinite(value) and all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes))


def test_off_is_as_if_it_were_not_there() -> None:
    on, off = (Model.create(jax.random.key(0), load_config(overrides=[f"light.cast={n}"]), FACTS) for n in (8, 0))
    assert off.casting is None and off.caster is None and off.field.appearance.parallax is None
    assert on.casting is not None and on.casting.samples == 8
    assert jax.tree.structure(replace(on, casting=None)) == jax.tree.structure(off)
    matte = load_config(overrides=["light.cast=8", "field.appearance=diffuse"])
    assert Model.create(jax.random.key(0), matte, FACTS).casting is None


@pytest.mark.parametrize("change", ["field.shading=sample", "sampler.kind=proposal"])
def test_what_cannot_cast_says_so(change: str) -> None:
    config = load_config(overrides=["light.cast=8", change])
    with pytest.raises(UsageError, match="reflected rays cannot be cast"):
        Casting.of(config, Model.create(jax.random.key(0), load_config(overrides=[change]), FACTS).sampler)
