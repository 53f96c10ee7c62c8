import jax
import numpy as np
import pytest

from koala3d.reconstruct.field.encodings.directional import view_channels, view_encoding


@pytest.mark.parametrize("degree", [0, 1, 4])
def test_it_is_the_direction_and_its_sines(degree: int) -> None:
    directions = np.random.default_rng(0).normal(size=(3, 20))
    directions /= np.linalg.norm(directions, axis=0)
    encoded = np.asarray(jax.jit(view_encoding, static_argnums=1)(np.float32(directions), degree))
    expected = [directions] + [wave(2.0**i * directions) for wave in (np.sin, np.cos) for i in range(degree)]
    assert encoded.shape == (view_channels(degree), 20)
    np.testing.assert_allclose(encoded, np.concatenate(expected), atol=1e-6)
