"""The fused step of Adam against optax's."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from hypothesis import given
from hypothesis import strategies as st

from koala3d.reconstruct.kernels import adam
from koala3d.reconstruct.training.optimiser import ADAM, DECAYS, SMALLEST
from tests import drawn

pytestmark = pytest.mark.usefixtures("kernels_run")

RATE, SHRINKS = 0.01, 0.03


def descended(gradient, parameter, mean, square, count, finite, shrinks=SHRINKS):
    options = {"decays": DECAYS, "smallest": SMALLEST, "shrinks": shrinks, "rate": jnp.float32(RATE)}
    return adam.descended(gradient, parameter, mean, square, count=count + 1, finite=finite, **options)


ours = jax.jit(descended)


@jax.jit
def theirs(gradient, parameter, mean, square, count, finite):
    update, state = ADAM.update(gradient + SHRINKS * parameter, optax.ScaleByAdamState(count, mean, square))
    new = parameter - RATE * update, state.mu, state.nu
    return jax.tree.map(lambda a, b: jnp.where(finite, a, b), new, (parameter, mean, square))


def arrays(shape: tuple[int, ...], sizes: float = 0.0) -> list[jax.Array]:
    """Gradient, parameter, mean and square; gradients spread over so many powers of ten."""
    gradient, parameter, mean, square, powers = np.random.default_rng(0).normal(size=(5, *shape))
    return [drawn.array(one) for one in (gradient * 10 ** (sizes * powers), parameter, mean, np.square(square))]


def assert_alike(given: list[jax.Array], count: int = 6, finite: bool = True) -> None:
    found, expected = (f(*given, np.int32(count), np.bool_(finite)) for f in (ours, theirs))
    expected = [np.asarray(one) for one in expected]
    given = [np.asarray(one) for one in given]
    gradient, before = np.abs(given[0]) + SHRINKS * np.abs(given[1]), [np.abs(one) for one in given[1:]]
    keep_mean, keep_square = DECAYS
    root = np.sqrt(expected[2] / (1 - keep_square ** (count + 1))) + SMALLEST
    added = ((1 - keep_mean) * gradient + keep_mean * before[1]) / (1 - keep_mean ** (count + 1)) / root  # whose parts may cancel
    terms = [before[0] + RATE * added, gradient + before[1], gradient * gradient + before[2]]
    for one, other, size in zip(found, expected, terms, strict=True):  # 2e-6 of what is added: a root and two quotients
        assert (np.abs(np.asarray(one) - np.asarray(other)) <= 2e-6 * size + 1e-37).all()


@pytest.mark.parametrize("shape", [(1,), (7,), (2, 32768), (3, 50001), (2**17,), pytest.param((2**20,), marks=pytest.mark.slow)])
def test_steps_are_those_of_optax(shape: tuple[int, ...]) -> None:
    assert_alike(arrays(shape))


@given(st.integers(0, 100000), st.floats(0, 4))
def test_any_count_and_gradients_of_any_size(count: int, sizes: float) -> None:
    assert_alike(arrays((2, 999), sizes), count)


def test_rows_that_were_never_touched_stay_where_they_are() -> None:
    zero = np.zeros(50000, np.float32)
    new = ours(zero, zero + 1, zero, zero, np.int32(3), np.bool_(True), 0.0)
    np.testing.assert_array_equal(new[0], 1)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_step_that_is_not_finite_changes_nothing(bad: float) -> None:
    given = arrays((50000,))
    given[0] = drawn.array(np.where(np.arange(50000) == 777, bad, given[0]))
    for one, other in zip(ours(*given, np.int32(3), np.bool_(False)), given[1:], strict=True):
        np.testing.assert_array_equal(one, other)


def test_what_is_given_stays_as_it_is_where_it_is_still_needed() -> None:
    given = arrays((50000,))
    copies = [np.array(one) for one in given]
    first = ours(*given, np.int32(3), np.bool_(True))
    second = ours(*given, np.int32(3), np.bool_(True))
    for one, other in zip((*given, *first), (*copies, *second), strict=True):
        np.testing.assert_array_equal(one, other)


def test_new_arrays_take_the_memory_of_the_old_in_a_loop() -> None:
    def steps(gradient, *state):
        one = lambda i, s: descended(gradient, *s, i, jnp.asarray(True))  # noqa: E731
        return jax.lax.fori_loop(0, 5, one, state)

    text = jax.jit(steps, donate_argnums=(1, 2, 3)).lower(*arrays((2, 32768))).compile().as_text()
    assert "f32[2,32768]{1,0} copy(" not in text
