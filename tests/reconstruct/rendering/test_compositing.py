import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.config import EncodingConfig, FieldConfig
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.field.outline import Outline
from koala3d.reconstruct.numerics.volume import SURFACE, optical_depth, volume_weights
from koala3d.reconstruct.rendering.compositing import composited, packed_depth
from koala3d.reconstruct.sampling.samples import RaySamples
from tests import drawn


def some_field(solid: bool) -> Field:
    """A field of which nothing counts but whether it is solid."""
    encoding = EncodingConfig(levels=1, features=2, log2_size=10, coarsest=1, finest=1)
    outline = Outline.of(None) if solid else None
    return drawn.filled(lambda: Field.create(jax.random.key(0), encoding, FieldConfig(spatial_width=16), outline=outline))


@pytest.mark.parametrize("solid", [False, True])
def test_packed_samples_are_composited_per_ray(solid: bool) -> None:
    edges = np.float32(np.sort(np.random.default_rng(0).uniform(0, 4, (6, 10)), -1))
    speed, density, values = np.linspace(1, 2, 6, dtype=np.float32), drawn.uniform(54, high=3), drawn.normal(3, 54)
    field = some_field(solid)

    @jax.jit
    def weights_and_sums(edges: jax.Array, speed: jax.Array, density: jax.Array, values: jax.Array) -> tuple[jax.Array, ...]:
        """Weights as packed and as tables, and sums of values."""
        samples = RaySamples.from_edges(edges)
        weights, sums = composited(packed_depth(field, density, samples, speed), (values,), samples)
        rows = density.reshape(6, 9)
        before = jnp.pad(rows[:, :-1], ((0, 0), (1, 0)))
        expected = volume_weights(optical_depth(rows, before, jnp.diff(edges) * speed[:, None], solid=solid))
        return weights, expected, sums[2:].T

    weights, expected, sums = weights_and_sums(edges, speed, density, values)
    np.testing.assert_allclose(weights, expected, atol=1e-6)
    np.testing.assert_allclose(sums, np.einsum("crs,rs->rc", np.asarray(values).reshape(3, 6, 9), weights), atol=1e-6)


def test_entries_that_only_fill_the_list_are_behind_nothing() -> None:
    rows = jnp.ones((2, 3))
    samples = RaySamples.in_rows(rows, rows, jnp.array([1, 3]))
    found = packed_depth(some_field(True), jnp.asarray([4.0, 9.0, 9.0, 2.0, 5.0, 3.0]), samples, rows[:, 0])
    np.testing.assert_allclose(found, SURFACE * np.array([4, 0, 0, 2, 3, 0]))
