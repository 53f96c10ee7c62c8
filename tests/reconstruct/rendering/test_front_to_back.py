"""Rays composited a few samples at a time show what all of their samples composited at once show."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reconstruct.config import Config
from reconstruct.field.field import Field
from reconstruct.numerics.compiling import jit
from reconstruct.rendering import front_to_back
from reconstruct.rendering.compositing import composite, sample_weights, values_of
from reconstruct.rendering.front_to_back import Queue, composited
from reconstruct.sampling.sampler import Sampled
from reconstruct.sampling.samples import Footprint, RaySamples, cloud_of
from reconstruct.scene.frustum import Frustum
from reconstruct.scene.rays import Rays
from reconstruct.scene.space import BALL, BOX, Space

FRUSTUM = Frustum(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, -3.0), 0.8, 0.4, 1.5, 6.0)
COUNT, SLOTS = 90, 10


def some_rays() -> Rays:
    rng = np.random.default_rng(0)
    directions = jnp.asarray(np.concatenate([rng.uniform(-0.3, 0.3, (COUNT, 2)), np.ones((COUNT, 1))], 1), jnp.float32)
    return Rays(jnp.tile(jnp.array([0.1, 0.0, -2.5]), (COUNT, 1)), directions, jnp.full(COUNT, 1e-3))


def some_samples(footprint: Footprint) -> Sampled:
    """Rows of different lengths, some of them empty; whole ones where footprints join each other."""
    rng = np.random.default_rng(1)
    edges = jnp.asarray(np.sort(rng.uniform(1.6, 4, (COUNT, SLOTS + 1)), 1), jnp.float32)
    filled = rng.integers(0, SLOTS + 1, COUNT) if footprint.kind == "point" else np.full(COUNT, SLOTS)
    samples = RaySamples.in_rows((edges[:, 1:] + edges[:, :-1]) / 2, jnp.diff(edges), jnp.asarray(filled))
    return Sampled(samples, footprint, jnp.ones(COUNT, bool))


def some_field(small_config: Config, space: Space, shading: str, density_bias: float) -> Field:
    config = small_config if space.bounded else small_config.with_surroundings()
    settings = config.field.model_copy(update={"shading": shading, "density_bias": density_bias})
    return Field.create(jax.random.key(0), config.encoding, settings)


def all_at_once(field: Field, rays: Rays, found: Sampled, space: Space) -> jax.Array:
    cloud = cloud_of(rays, found.samples, space=space, footprint=found.footprint)
    density, material, normals = field.with_normals(cloud)
    weights = found.samples.packed(sample_weights(density, found.samples, rays.speed))
    t = found.samples.t
    channels = jnp.concatenate([jnp.stack([jnp.ones_like(t), t]), *values_of(field, material, rays, found.samples), normals])
    return composite(channels, weights, found.samples)


@pytest.mark.parametrize("space", [BOX, BALL, FRUSTUM])
@pytest.mark.parametrize("shading", ["deferred", "samples"])
@pytest.mark.parametrize("places", [16, 2048])
def test_bit_by_bit_is_all_at_once(
    small_config: Config, space: Space, shading: str, places: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(front_to_back, "UNDER_WAY", (places, places))
    field, rays, found = some_field(small_config, space, shading, 1.0), some_rays(), some_samples(Footprint())
    ours = jit(lambda: composited(field, rays, found, Queue.of(found.samples, jnp.asarray(COUNT)), space, normals=True))()
    np.testing.assert_allclose(ours, jit(lambda: all_at_once(field, rays, found, space))(), rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("footprint", [Footprint("gaussian"), Footprint("hexagon", jnp.linspace(0, 3, COUNT))])
def test_frustums_stay_what_they_are(small_config: Config, footprint: Footprint) -> None:
    field, rays, found = some_field(small_config, BALL, "samples", 1.0), some_rays(), some_samples(footprint)
    ours = jit(lambda: composited(field, rays, found, Queue.of(found.samples, jnp.asarray(COUNT)), BALL, normals=True))()
    np.testing.assert_allclose(ours, jit(lambda: all_at_once(field, rays, found, BALL))(), rtol=2e-5, atol=2e-5)


def test_what_is_behind_an_opaque_surface_is_left_out_and_not_missed(small_config: Config) -> None:
    field, rays, found = some_field(small_config, BOX, "deferred", 4.0), some_rays(), some_samples(Footprint())
    ours = jit(lambda: composited(field, rays, found, Queue.of(found.samples, jnp.asarray(COUNT)), BOX, normals=True))()
    every = np.asarray(jit(lambda: all_at_once(field, rays, found, BOX))())
    missing = every[:, 0] - np.asarray(ours)[:, 0]
    assert missing.max() > 1e-6, "some of it is left out"
    assert missing.max() < 1.01e-3 and missing.min() > -1e-5


def test_rays_that_are_none_are_not_composited(small_config: Config) -> None:
    field, rays, found = some_field(small_config, BOX, "deferred", 1.0), some_rays(), some_samples(Footprint())
    queue = Queue.of(found.samples, jnp.asarray(40))
    assert int(queue.count) == np.sum(np.asarray(found.samples.valid).reshape(COUNT, SLOTS)[:40, 0])
    sums = jit(lambda: composited(field, rays, found, queue, BOX, normals=False))()
    np.testing.assert_array_equal(sums[40:], 0)
    assert np.asarray(sums[:40, 0]).max() > 0.1
