"""The step down a gradient: which parameters weight decay shrinks, and by how much."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.training.optimiser import DECAYS, Optimiser

FACTS = SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.5, 4.0))
PROPOSALS = ["sampler.kind=proposal", "sampler.proposal_finest=[12, 12]", "field.outward=0"]


@pytest.mark.parametrize("log2_size", [6, pytest.param(13, id="through a kernel, if kernels run")])
def test_decay_is_that_of_each_level_of_field_and_proposals(log2_size: int) -> None:
    """Without a loss, Adam's mean after one step is a tenth of the decay's slope: 2 / (rows * features) of each value."""
    small = ["encoding.levels=2", f"encoding.log2_size={log2_size}", "encoding.finest=12", "losses.decay=0.3"]
    config = load_config(overrides=[*small, *PROPOSALS])
    model = Model.create(jax.random.key(0), config, FACTS)
    tables = lambda m: [m.field.encoding.table, *(p.encoding.table for p in m.sampler.proposals)]  # noqa: E731
    values = [jnp.full_like(table, value) for table, value in zip(tables(model), (0.1, 0.2, -0.4), strict=True)]
    learned, _ = eqx.tree_at(tables, model, values).split()
    optimiser, one = Optimiser.of(config, FACTS), jnp.ones(())
    nothing = jax.tree.map(jnp.zeros_like, learned)
    new, moments = jax.jit(optimiser.descended)(learned, nothing, optimiser.begin(learned), 0.5 * one, one > 0, jnp.zeros((1, 3)))
    encodings = [model.field.encoding, *model.sampler.encodings]
    for encoding, value, mean, after in zip(encodings, values, tables(moments.mu), tables(new), strict=True):
        numbers = 2**encoding.log2_size * encoding.table.shape[0]
        np.testing.assert_allclose(mean, (1 - DECAYS[0]) * 0.3 * 2 / numbers * value, rtol=1e-5)
        assert (np.abs(after) < np.abs(value)).all()
    networks = eqx.tree_at(tables, new, values)
    assert all(jax.tree.leaves(jax.tree.map(lambda a, b: bool((a == b).all()), networks, learned))), "nothing else shrinks"
