"""Every model can give two places different colours from one direction: what none can do, no training finds."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.config import Config
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.models import load_config, merged, names
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.scene.space import BOX
from tests import drawn

SMALL = {
    "encoding": {"levels": 3, "log2_size": 8, "coarsest": 2.0, "finest": 16.0},
    "sampler": {"grid": 8},
    "field": {"ide_degree": 2},
}
"""Sizes that do not matter here: there is one direction to encode. The bottleneck and all else
about colour stay as the model file has them."""
FACTS = SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 1.5, 4.5))
DIFFERENT = 0.01
"""Between colours in [0, 1]; equal ones differ by rounding, 1e-7. With features of standard deviation 1 these differ by 0.03."""


def colours(model: str, preset: str) -> np.ndarray:
    """(3, 2) colours of two places from one direction, with features as large as a training makes them."""
    config = Config.model_validate(merged(load_config(model, preset).model_dump(), SMALL))
    field: Field = drawn.filled(lambda: Model.create(jax.random.key(0), config, FACTS).field)
    if hasattr(field.encoding, "table"):
        field = eqx.tree_at(lambda one: one.encoding.table, field, drawn.normal(*field.encoding.table.shape, seed=1))
    return np.asarray(shown(field))


@jax.jit
def shown(field: Field) -> jax.Array:
    """Colours of two places from one direction."""
    places = jnp.array([[0.3, -0.5], [0.1, 0.4], [-0.2, 0.6]])
    _, material = field(Cloud(places, jnp.full(2, 1e-3), BOX))
    towards = jnp.tile(jnp.array([[0.6], [0.0], [-0.8]]), (1, 2))
    return field.shade(material, towards).rgb


@pytest.mark.parametrize("model", names())
@pytest.mark.parametrize("preset", ["fast", "paper"])
def test_two_places_differ_from_one_direction(model: str, preset: str) -> None:
    first, second = colours(model, preset).T
    assert np.abs(first - second).max() > DIFFERENT
