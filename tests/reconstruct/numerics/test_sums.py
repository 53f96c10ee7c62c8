import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.numerics.volume import sum_before


@pytest.mark.parametrize("block", [None, 32, 96])
def test_sums_equal_those_of_a_loop(block: int | None) -> None:
    values = np.random.default_rng(0).random((5, 96))
    expected = [[sum(row[:i]) for i in range(96)] for row in values]
    np.testing.assert_allclose(sum_before(jnp.asarray(values, jnp.float32), block), expected, rtol=2e-6, atol=1e-6)
