"""A whole pass of rendering and losses under JAX's strict switches: no silent change of type, no NaN on the way."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.field.encodings.directional import integrated_directional_encoding
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.numerics.safe import normalise, safe_exp, safe_norm, srgb_from_linear
from koala3d.reconstruct.numerics.stepfun import inverse_power_ladder, power_ladder, resample_blurred, sample_intervals
from koala3d.reconstruct.numerics.volume import volume_weights
from koala3d.reconstruct.rendering.model import Model, render
from koala3d.reconstruct.sampling.sampler import Sampled
from koala3d.reconstruct.sampling.samples import Footprint, RaySamples, cloud_of
from koala3d.reconstruct.scene.contraction import contract, contraction_scale, pull_back
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation, Rays
from koala3d.reconstruct.scene.space import BALL
from koala3d.reconstruct.surface import ball, first_surface, regularisers
from koala3d.reconstruct.surface.first_surface import Surfaces, find_surfaces
from koala3d.reconstruct.surface.place import Place
from koala3d.reconstruct.training import losses, objective
from koala3d.reconstruct.training.step import Step

FACTS = SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 1.0, 5.0))
SMALL = [
    "surface.density=0.1",
    "surface.bias=0.03",
    "encoding.levels=2",
    "encoding.log2_size=8",
    "field.spatial_width=8",
    "field.view_width=8",
    "surface.rays=8",
    "surface.samples=8",
]


@pytest.fixture
def nans_are_errors() -> Iterator[None]:
    with jax.debug_nans(True):
        yield


def some(*shape: int, seed: int = 0) -> jax.Array:
    return jax.random.uniform(jax.random.key(seed), shape)


ELEMENTARY: dict[str, Callable[[], object]] = {
    "safe_exp": lambda: safe_exp(some(5)),
    "safe_norm": lambda: safe_norm(some(5, 3)),
    "normalise": lambda: normalise(some(5, 3)),
    "srgb": lambda: srgb_from_linear(some(5)),
    "contract": lambda: (contract(some(5, 3)), contraction_scale(some(5, 3)), pull_back(some(5, 3), some(5, 3))),
    "ladder": lambda: inverse_power_ladder(power_ladder(some(5), -1.5, 2.0), -1.5, 2.0),
    "resample_blurred": lambda: resample_blurred(jnp.sort(some(2, 9)), jnp.sort(some(2, 5)), some(2, 4), 0.03),
    "volume_weights": lambda: volume_weights(some(2, 4)),
    "directional": lambda: integrated_directional_encoding(normalise(some(5, 3)).T, some(5), 5),
    "first_surface": lambda: first_surface.first_surface(some(4, 6), some(4, 6) > 0.3),
    "radius": lambda: first_surface.neighbourhood_radius(some(4), some(4), some(4)),
    "rotations": lambda: ball.random_rotations(jax.random.key(0), 4),
    "charbonnier": lambda: losses.charbonnier(some(4), 1e-3),
    "interlevel": lambda: losses.interlevel(some(2, 4), some(2, 4)),
    "distortion": lambda: losses.distortion(some(2, 4), some(2, 4), some(2, 4)),
    "hollowness": lambda: losses.hollowness(some(2, 4), some(2, 4)),
    "fog": lambda: losses.fog(some(2, 4), some(2, 4), some(2, 4), jnp.array([1, 3])),
    "smoothness": lambda: regularisers.density_smoothness(some(2, 4), some(2, 4, 3), some(2, 3), some(2), "tangent"),
    "consistency": lambda: regularisers.normal_consistency(some(2, 4, 3), some(2, 3)),
    "bias": lambda: regularisers.lambertian_bias(some(2, 4, 3)),
    "bias for two kinds": lambda: regularisers.metal_or_not(some(2, 3), some(2, 4, 3)),
    "variation": lambda: regularisers.specular_variation(some(2, 8, 3), regularisers.direction_likeness(some(2, 8, 3)), 3),
}


@pytest.mark.parametrize("name", ELEMENTARY)
def test_float32_stays_float32_without_silent_promotion(name: str, nans_are_errors: None) -> None:
    with jax.numpy_dtype_promotion("strict"):
        result = jax.jit(ELEMENTARY[name])()
    for leaf in jax.tree.leaves(result):
        assert leaf.dtype in (jnp.float32, jnp.int32), leaf.dtype


def test_sampling_stays_in_range_of_its_type(nans_are_errors: None) -> None:
    assert sample_intervals(some(3), jnp.sort(some(3, 9)), some(3, 8), 5).dtype == jnp.float32


def rays_of(count: int) -> Rays:
    """Through the origin from all around; two that miss everything."""
    origins = normalise(some(count, 3, seed=1) - 0.5) * 3
    directions = -origins / 3 * jnp.where(jnp.arange(count) < 2, -1.0, 1.0)[:, None]
    return Rays(origins, directions, jnp.full(count, 1e-3))


@pytest.fixture(scope="module", params=["deferred", pytest.param("sample", marks=pytest.mark.slow)])
def graded(request: pytest.FixtureRequest) -> tuple[Model, Callable]:
    """A small model, and a compiled function of (model, edges of 16 rays' intervals) to ((total, terms), gradient)."""
    config = load_config(overrides=[*SMALL, f"field.shading={request.param}", "surface.variation=0.001"])
    rays, place = rays_of(16), Place(BALL)
    step = Step.of(config, FACTS)
    regularisers = replace(step.second_pass, place=place)

    def total(model: Model, edges: jax.Array) -> tuple[jax.Array, dict[str, jax.Array]]:
        samples = RaySamples.from_edges(edges)
        cloud = cloud_of(rays, samples, space=BALL, footprint=Footprint())
        rendered, density = render(model.field, rays, samples, cloud)
        terms = objective.photometric(rendered, some(16, 4), jnp.ones((16, 3)), jnp.ones(16, bool), 1e-3)
        found = Sampled(samples, Footprint(), jnp.ones(16, bool))
        terms |= objective.distortion_term(rendered, found, 0.01)
        terms |= objective.hollowness_term(rendered, density, found, 0.1) | objective.fog_term(rendered, found, 0.1)
        surfaces = jax.lax.stop_gradient(find_surfaces(rendered.weights, samples, rays.radii, config.surface.rays))
        terms |= objective.surface_point_terms(model.field, rays, surfaces, step.objective.weights, place, jnp.ones(()))
        terms |= regularisers.terms(model.field, rays, Surfaces(surfaces, surfaces), jax.random.key(1), 0.5)
        return objective.total(terms), terms

    def graded(model: Model, edges: jax.Array):
        learned, held = model.split()
        return jax.value_and_grad(lambda learned: total(eqx.combine(learned, held), edges), has_aux=True)(learned)

    return Model.create(jax.random.key(0), config, FACTS), jax.jit(graded)


@pytest.mark.parametrize("case", ["ordinary", "opaque", "empty", "of no length", "blank"])
def test_all_terms_and_their_gradients_are_finite_on_hard_cases(
    case: str, graded: tuple[Model, Callable], nans_are_errors: None
) -> None:
    model, evaluate = graded
    raw = {"opaque": 1e4, "empty": -1e4}.get(case, 1.0)
    if case == "blank":  # no density gradient, no predicted normal: nothing to normalise
        model = jax.tree.map(jnp.zeros_like, model)
    model = eqx.tree_at(lambda m: m.field.spatial.biases[-1], model, model.field.spatial.biases[-1].at[0].set(raw))
    ends = (2.0, 2.0) if case == "of no length" else (1.0, 5.0)
    (_, terms), gradient = evaluate(model, jnp.broadcast_to(jnp.linspace(*ends, 9), (16, 9)))
    for name, term in terms.items():
        assert np.isfinite(term), name
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
    if case in ("empty", "of no length"):
        assert terms["orientation"] == terms["density_smoothness"] == terms["specular_variation"] == 0, "rays without a surface"
    if case == "opaque":
        assert terms["density_smoothness"] > 0, "there are surfaces"
