import jax.numpy as jnp
import numpy as np

from koala3d.reconstruct.training.pace.schedules import RISE, late, learning_rate


def test_the_rate_is_log_linear_after_warm_up() -> None:
    at = lambda p: float(learning_rate(jnp.asarray(p), rate=0.01, final_rate=0.001, warmup=0.1))  # noqa: E731
    np.testing.assert_allclose([at(0.5), at(1.0)], [0.01 * 10**-0.5, 0.001], rtol=1e-5)
    np.testing.assert_allclose(at(0.1), 0.01 * 10**-0.1, rtol=1e-5)
    np.testing.assert_allclose(at(0.0), 0.01 * 1e-8, rtol=1e-4)
    rising = [at(p) for p in np.linspace(0, 0.1, 11)]
    assert (np.diff(rising) > 0).all()


def test_no_warm_up_starts_at_the_rate() -> None:
    np.testing.assert_allclose(learning_rate(jnp.asarray(0.0), rate=0.01, final_rate=0.001, warmup=0.0), 0.01, rtol=1e-6)


def test_a_late_loss_rises_from_its_start() -> None:
    at = lambda p: float(late(jnp.asarray(p), start=0.2))  # noqa: E731
    assert at(0.0) == at(0.2) == 0.0 and at(0.2 + RISE) == at(1.0) == 1.0
    np.testing.assert_allclose(at(0.2 + RISE / 2), 0.5, rtol=1e-5)
    assert float(late(jnp.asarray(0.0), start=0.0)) == 1.0
