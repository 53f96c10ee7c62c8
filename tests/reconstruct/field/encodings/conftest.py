"""Points that every encoding is looked at."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest


@pytest.fixture(scope="module")
def points() -> jax.Array:
    """(3, 400) points of [-1.5, 1.5]^3, float32."""
    return jnp.asarray(np.random.default_rng(0).uniform(-1.5, 1.5, (3, 400)), jnp.float32)
