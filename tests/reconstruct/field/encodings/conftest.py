"""Points that every encoding is looked at."""

import jax
import pytest

from tests import drawn


@pytest.fixture(scope="module")
def points() -> jax.Array:
    """(3, 400) points of [-1.5, 1.5]^3, float32."""
    return drawn.uniform(3, 400, low=-1.5, high=1.5)
