import jax
import numpy as np
import pytest

from koala3d.reconstruct.field.mlp import Mlp
from tests import drawn

CALL = jax.jit(lambda network, inputs: network(inputs))


@pytest.mark.parametrize(("depth", "skip"), [(1, 0), (3, 0), (3, 2), (4, 2)])
def test_it_equals_layers_written_out(depth: int, skip: int) -> None:
    network = drawn.filled(lambda: Mlp.create(jax.random.key(0), channels=5, width=16, depth=depth, outputs=3, skip=skip))
    inputs = np.random.default_rng(0).normal(size=(5, 7))
    hidden = inputs
    for layer, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        if skip and layer == skip:
            hidden = np.concatenate([hidden, inputs])
        hidden = np.asarray(weight, np.float64) @ hidden + np.asarray(bias)[:, None]
        hidden = np.maximum(hidden, 0) if layer < depth else hidden
    np.testing.assert_allclose(CALL(network, np.float32(inputs)), hidden, atol=1e-5)
    assert len(network.weights) == depth + 1


def test_fresh_weights_keep_the_signal_s_size() -> None:
    """He's rule: the mean square of pre-activations stays that of the input through layers of 256, within a factor 2."""
    network = Mlp.create(jax.random.key(1), channels=256, width=256, depth=4, outputs=256)
    outputs = np.asarray(CALL(network, drawn.normal(256, 200)))
    # He's factor 2 makes up for the ReLU, so that the first layer doubles and the last, without one, halves nothing
    assert 0.5 < np.mean(outputs**2) < 2
