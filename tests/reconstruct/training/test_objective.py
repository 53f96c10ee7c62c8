"""How the losses are put together, on rays that are worked by hand."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.config import LossConfig, SurfaceConfig
from koala3d.reconstruct.field.appearance import Material, Shading
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.rendering.model import Model, Rendered
from koala3d.reconstruct.sampling.sampler import Sampled
from koala3d.reconstruct.sampling.samples import Footprint, RaySamples
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation, Rays
from koala3d.reconstruct.scene.space import BOX
from koala3d.reconstruct.surface import second_pass
from koala3d.reconstruct.surface.first_surface import Surface, Surfaces
from koala3d.reconstruct.surface.place import Place
from koala3d.reconstruct.surface.second_pass import SecondPass
from koala3d.reconstruct.training import objective

SMALL = ["encoding.levels=2", "encoding.log2_size=4", "field.spatial_width=4", "field.view_width=4", "sampler.grid=8"]
FACTS = SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.5, 4.5))
TILTED = np.array([np.sqrt(0.75), 0.0, 0.5])
"""60 degrees from z."""
PREDICTED = np.array([0.0, 0.6, -0.8])
RADII = np.array([1.0, 0.5, 1.0, 0.5])
DIRECTIONS = np.array([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0], [-1.0, 0, 0]])
"""From a surface point: out of the surface, into it, and along it twice."""


class HalfSpace(Field):
    """Density 10 where z <= 0. Normals: z on the surface, `TILTED` elsewhere. Reflected colour in direction d: max(0, -d_z)."""

    def with_normals(self, cloud: Cloud, shown: int | None = None) -> tuple[jax.Array, Material, jax.Array]:
        z, count = cloud.points[2], cloud.points.shape[1]
        columns = lambda vector: jnp.asarray(vector, jnp.float32)[:, None]  # noqa: E731
        normals = jnp.where(z == 0, columns([0, 0, 1.0]), columns(TILTED))
        some = jnp.ones((3, count))[:, :shown]
        material = Material(some, some, some[:1], some * columns(PREDICTED), jnp.zeros((0, some.shape[1])))
        return jnp.where(z <= 0, 10.0, 0.0), material, normals

    def shade(
        self,
        material: Material,
        viewdirs: jax.Array,
        normals: jax.Array | None = None,
        light: Lit | None = None,
        places: jax.Array | None = None,
    ) -> Shading:
        specular = jnp.broadcast_to(jnp.maximum(-viewdirs[2], 0.0), viewdirs.shape)
        return Shading(2 * specular, specular)


def half_space(appearance: str = "reflection") -> HalfSpace:
    field = Model.create(jax.random.key(0), load_config(overrides=[*SMALL, f"field.appearance={appearance}"]), FACTS).field
    return HalfSpace(**vars(field))


@pytest.fixture
def rays() -> Rays:
    """Two rays straight down from z = 2, which meet the surface at t = 2."""
    down = jnp.tile(jnp.array([[0.0, 0.0, -1.0]]), (2, 1))
    return Rays(jnp.array([[0.0, 0.0, 2.0], [0.3, 0.0, 2.0]]), down, jnp.full(2, 0.05))


@pytest.fixture
def surface() -> Surface:
    """The first ray's surface has weight 0.8; the second entry is none, as where fewer rays have a surface than are wanted."""
    return Surface(jnp.array([0, 1], jnp.int32), jnp.full(2, 2.0), jnp.array([0.8, 0.0]), jnp.full(2, 0.1))


def rendered(weights: list[list[float]], rgb: list[list[float]] | None = None) -> Rendered:
    w = jnp.asarray(weights)
    count, dark = w.shape[0], jnp.zeros((w.shape[0], 3))
    colour = dark if rgb is None else jnp.asarray(rgb)
    return Rendered(colour, w.sum(-1), dark, dark, jnp.zeros(count), dark, jnp.zeros(count), w)


def weights(**changed: float) -> LossConfig:
    nothing = dict.fromkeys(LossConfig.model_fields, 0.0)
    return LossConfig(**{**nothing, "last_density_normals": None, "width": 1e-3, **changed})


def test_colours_count_over_the_background_for_used_rays_alone() -> None:
    seen = rendered([[0.5], [1.0], [1.0]], [[0.2] * 3, [0.9] * 3, [0.1] * 3])
    truth = jnp.array([[0.4, 0.4, 0.4, 0.5], [0.5, 0.5, 0.5, 1.0], [0.9, 0.9, 0.9, 1.0]])
    used = jnp.array([True, True, False])
    found = objective.photometric(seen, truth, jnp.ones((3, 3)), used, width=0.3)
    # over white: 0.2 + 0.5 against 0.4 * 0.5 + 0.5, no error, Charbonnier 0.3
    # then an error of 0.4: sqrt(0.16 + 0.09) = 0.5; the third ray is ignored
    np.testing.assert_allclose(found["photometric"], (0.3 + 0.5) / 2, rtol=1e-5)
    np.testing.assert_allclose(found["mse"], 0.16 / 2, rtol=1e-5)
    np.testing.assert_allclose(objective.total(found), 0.4, rtol=1e-5, err_msg="the mean square error is for the log")


def sampled(samples: RaySamples) -> Sampled:
    """Rays that have samples take part."""
    return Sampled(samples, Footprint(), jnp.any(samples.valid.reshape(samples.num_rays, -1), -1))


def test_distortion_of_two_samples() -> None:
    """Intervals [1, 2] and [2, 4], weights 0.5 and 0.25: 2 * 0.5 * 0.25 * (3 - 1.5) + (0.25 * 1 + 0.0625 * 2) / 3 = 0.5."""
    samples = RaySamples.from_edges(jnp.array([[1.0, 2.0, 4.0]]))
    found = objective.distortion_term(rendered([[0.5, 0.25]]), sampled(samples), 0.01)
    np.testing.assert_allclose(found["distortion"], 0.01 * 0.5, rtol=1e-5)


def test_hollowness_of_three_samples() -> None:
    """Densities 0, 10, 5, weights 0, 0.6, 0.3: the third sample lost half, 0.3 * 0.6 * 0.5 = 0.09."""
    samples = RaySamples.from_edges(jnp.array([[1.0, 2.0, 3.0, 4.0]]))
    found = objective.hollowness_term(rendered([[0.0, 0.6, 0.3]]), jnp.array([0.0, 10.0, 5.0]), sampled(samples), 0.1)
    np.testing.assert_allclose(found["hollowness"], 0.1 * 0.09, rtol=1e-5)


def test_interlevel_loss_of_one_interval_per_level() -> None:
    """All weight in [0, 0.5], density 2. A blur of half-width b takes 2 b / 4 of it below 0: 0.985 and 0.9985 are left in [0, 1].

    Proposals have 0.7 and 0.9 there: 0.285^2 / 0.70001 + 0.0985^2 / 0.90001 = 0.126811.
    """
    edges = jnp.array([[0.0, 0.5, 1.0]])
    whole = jnp.array([[0.0, 1.0]])
    levels = ((whole, jnp.array([[0.7]])), (whole, jnp.array([[0.9]])))
    found = objective.interlevel_term(edges, jnp.array([[1.0, 0.0]]), levels)
    np.testing.assert_allclose(found["interlevel"], 0.01 * 0.126811, rtol=1e-4)


def test_normals_at_first_surfaces(rays: Rays, surface: Surface) -> None:
    """The density's normal is z, the predicted one (0, 0.6, -0.8): |n - n'|^2 = 0.36 + 3.24 = 3.6, and it faces away: 0.8^2."""
    wanted = weights(orientation=0.1, predicted_normals=3e-4, density_normals=1e-4)
    at = lambda field, wanted: objective.surface_point_terms(field, rays, surface, wanted, Place(BOX), 1e-4)  # noqa: E731
    found = at(half_space(), wanted)
    np.testing.assert_allclose(found["predicted_normals"], 0.8 * (3e-4 + 1e-4) * 3.6, rtol=1e-5)
    np.testing.assert_allclose(found["orientation"], 0.1 * 0.8 * 0.64, rtol=1e-5)
    alone = at(half_space("view"), wanted)
    assert alone.keys() == {"orientation"} and float(alone["orientation"]) == 0, "nothing is predicted, and z faces the camera"
    assert at(half_space(), weights()) == {}


def test_fog_of_two_rays() -> None:
    """Weights 0.1, 0.6 and 0, 0.9 at 1.5 and 3, samples 1 and 0.5 long: 0.1 lies 1.5 > 2 * 0.5 before a surface.

    A third ray takes no part.
    """
    samples = RaySamples.in_rows(jnp.array([[1.5, 3.0]] * 3), jnp.array([[1.0, 0.5]] * 3), jnp.array([2, 2, 0]))
    found = objective.fog_term(rendered([[0.1, 0.6], [0.0, 0.9], [0.0, 0.0]]), sampled(samples), 0.01)
    np.testing.assert_allclose(found["fog"], 0.01 * 0.1 / 2, rtol=1e-5)


WANTED = SurfaceConfig(samples=4, reach=2.0, density=0.1, normal=0.1, bias=0.03, variation=1e-3)
REGULARISERS = SecondPass(Place(BOX), WANTED)


def with_changes(**changes: float) -> SecondPass:
    return replace(REGULARISERS, surface=WANTED.model_copy(update=changes))


@pytest.fixture
def fixed_directions(monkeypatch: pytest.MonkeyPatch) -> None:
    directions = jnp.asarray(np.tile(DIRECTIONS, (2, 1, 1)), jnp.float32)
    monkeypatch.setattr(second_pass, "NEIGHBOURS", 1)
    monkeypatch.setattr(second_pass, "ball_samples", lambda *_: (directions, jnp.asarray(RADII, jnp.float32)))


def test_regularisers_of_one_surface_point(rays: Rays, surface: Surface, fixed_directions: None) -> None:
    """Samples at 0.2 above, 0.1 below, 0.2 and 0.1 beside; the radius of the ball is 2 * 0.1 = 0.2, the ray's weight 0.8."""
    found = REGULARISERS.terms(half_space(), rays, Surfaces(surface, surface), jax.random.key(0), 1.0)
    # alpha = 1 - exp(-10 * 0.2) = 0.864665 but above, where it is 0; |r . n| is 1 below, 0 beside: mean 0.216166
    np.testing.assert_allclose(found["density_smoothness"], 0.1 * 0.8 * 0.216166, rtol=1e-5)
    # (1 - cos 60) / 2 = 0.25 above and below, 0 beside, where the normal is z: mean 0.125
    np.testing.assert_allclose(found["normal_consistency"], 0.1 * 0.8 * 0.125, rtol=1e-5)
    # "out" is flipped to look at the surface: colours 1, 1, 0, 0, relative to their maximum 1; three channels: 3 * 2 / 4
    np.testing.assert_allclose(found["lambertian_bias"], 0.03 * 0.8 * 1.5, rtol=1e-5)
    # the first two are alike; the others' nearest is across (cosine 0) rather than opposite (-1): 3 * |0 - 1| for two of four
    np.testing.assert_allclose(found["specular_variation"], 1e-3 * 0.8 * 1.5, rtol=1e-5)


def test_without_a_diffuse_colour_the_colour_itself_varies(rays: Rays, surface: Surface, fixed_directions: None) -> None:
    found = REGULARISERS.terms(half_space("view"), rays, Surfaces(surface, surface), jax.random.key(0), 1.0)
    assert "lambertian_bias" not in found
    np.testing.assert_allclose(found["specular_variation"], 2 * 1e-3 * 0.8 * 1.5, rtol=1e-5)  # rgb is twice the specular colour


def test_the_reach_scales_the_ball(rays: Rays, surface: Surface, fixed_directions: None) -> None:
    """Half the reach: alpha = 1 - exp(-10 * 0.1) = 0.632121."""
    near = with_changes(reach=1.0).terms(half_space(), rays, Surfaces(surface, surface), jax.random.key(0), 1.0)
    np.testing.assert_allclose(near["density_smoothness"], 0.1 * 0.8 * 0.632121 / 4, rtol=1e-5)


def test_regularisers_without_a_weight_are_not_computed(rays: Rays, surface: Surface, fixed_directions: None) -> None:
    spatial = with_changes(bias=0.0, variation=0.0).terms(half_space(), rays, Surfaces(surface, surface), jax.random.key(0), 1.0)
    directional = with_changes(density=0.0, normal=0.0).terms(
        half_space(), rays, Surfaces(surface, surface), jax.random.key(0), 1.0
    )
    assert spatial.keys() == {"density_smoothness", "normal_consistency"}
    assert directional.keys() == {"lambertian_bias", "specular_variation"}


def test_a_saturated_channel_tells_no_more_than_the_least_light() -> None:
    """Red is above the clipped value, green below it; the second ray is half transparent, and counts as it is."""
    seen = rendered([[1.0], [1.0]], [[1.2, 0.8, 0.5], [1.2, 0.8, 0.5]])
    colour = jnp.array([[1.0, 1.0, 0.5, 1.0], [1.0, 1.0, 0.5, 0.5]])
    background, used = jnp.ones((2, 3)), jnp.ones(2, bool)
    error = np.array([[0.2, -0.2, 0.0], [0.2, -0.2, -0.25]])
    plain = objective.photometric(seen, colour, background, used, 0.01)["mse"]
    np.testing.assert_allclose(plain, np.mean(error**2), rtol=1e-5)
    clipped = objective.photometric(seen, colour, background, used, 0.01, True)["mse"]
    error[0, 0] = 0
    np.testing.assert_allclose(clipped, np.mean(error**2), rtol=1e-5)


def test_light_reaches_what_a_thousandth_of_it_is_left_for() -> None:
    """Four of four samples in fog, one behind a wall of 0.9995, two behind a thin and a thick layer; one ray takes no part."""
    weights = jnp.array([[0.25, 0.25, 0.25, 0.2], [0.9995, 4e-4, 0, 0], [0.5, 0.4995, 4e-4, 0], [0.9995, 0, 0, 0]])
    samples = RaySamples.in_rows(jnp.ones((4, 4)), jnp.ones((4, 4)), jnp.array([4, 4, 4, 0]))
    found = Sampled(samples, Footprint(), jnp.array([True, True, True, False]))
    assert objective.lit(weights, found) == pytest.approx((4 + 1 + 2) / 3)
