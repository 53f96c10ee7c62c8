"""What the compiler is told."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.numerics import compiling


@pytest.mark.parametrize("count", [100, 16384, 24000])
def test_sums_of_repeated_factors_are_right(count: int) -> None:
    keys = jax.random.split(jax.random.key(0), 2)
    first, second = jax.random.normal(keys[0], (16, count)), jax.random.normal(keys[1], (16, 3, count))
    found = compiling.jit(lambda a, b: jnp.sum(a[:, None] * b, 0))(first, second)
    expected = np.einsum("cn,cxn->xn", np.asarray(first, np.float64), np.asarray(second, np.float64))
    np.testing.assert_allclose(found, expected, atol=1e-5)  # 16 products of order one, rounded at 6e-8 each


def test_an_option_that_this_version_has_not_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiling, "PLAIN_SUMS", {"xla_no_such_option": ""})
    assert compiling.compiler_options() == (compiling.KEEP_BARRIERS if jax.default_backend() == "cpu" else {})
