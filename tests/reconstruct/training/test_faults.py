import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.training.faults import FAULTS, cause, finite_parts, packed, parts_of

SMALL = ["encoding.levels=2", "encoding.log2_size=8", "field.spatial_width=8", "field.view_width=8"]


@pytest.fixture(scope="module")
def model() -> Model:
    facts = SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.5, 4.0))
    return Model.create(jax.random.key(0), load_config(overrides=SMALL), facts).split()[0]


def test_a_finite_step_has_no_faults(model: Model) -> None:
    terms = {"photometric": jnp.ones(()), "mse": jnp.ones(())}
    assert int(packed(finite_parts(model), terms)) == 0 and cause(0, model, terms) == ""


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e20])
def test_the_part_at_fault_is_named(model: Model, value: float) -> None:
    """1e20 is finite, its square in Adam's second moment is not."""
    terms = {"photometric": jnp.ones(()), "decay": jnp.asarray(value), "mse": jnp.ones(())}
    wrong = eqx.tree_at(lambda m: m.field.encoding.table, model, model.field.encoding.table.at[0, 3].set(value))
    assert parts_of(model) == list(finite_parts(model)) == ["field.encoding", "field.spatial", "field.appearance"]
    faults = int(packed(finite_parts(wrong), terms))
    expected = "gradient of field.encoding" + ("" if value == 1e20 else ", loss decay")
    assert cause(faults, model, {**terms, FAULTS: jnp.asarray(faults)}) == expected
