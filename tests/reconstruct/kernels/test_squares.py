"""Sums of squares by a compiled loop against plain JAX."""

import jax
import numpy as np
import pytest

from koala3d.reconstruct.kernels.squares import CHUNK, sum_of_squares
from tests import drawn

pytestmark = pytest.mark.usefixtures("kernels_run")


@pytest.mark.parametrize("count", [1, 2 * CHUNK - 1, 2 * CHUNK, 2 * CHUNK + 1, 2**20])
def test_value(count: int) -> None:
    array = drawn.normal(1, count)
    value = jax.jit(sum_of_squares)(array)
    expected = np.sum(np.square(np.asarray(array, np.float64)))
    np.testing.assert_allclose(value, expected, rtol=1e-5)  # sums of at most 2,048 rounded numbers in each lane


@pytest.mark.parametrize("odd", [np.nan, np.inf, 1e30])
def test_what_has_no_square_shows(odd: float) -> None:
    assert not np.isfinite(jax.jit(sum_of_squares)(np.where(np.arange(3 * CHUNK) == CHUNK + 3, np.float32(odd), np.float32(1))))
