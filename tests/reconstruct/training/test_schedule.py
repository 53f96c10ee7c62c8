import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.models import load_config, of_kinds
from koala3d.reconstruct.training.schedule import GAIN, RISE, Schedule, late, learning_rate


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


def test_the_second_pass_s_period_falls_from_512_to_4_in_powers_of_two() -> None:
    period = Schedule(load_config(preset="paper")).second_pass_period
    periods = [period(p) for p in np.linspace(0, 1, 1000)]
    assert list(dict.fromkeys(periods)) == [512, 256, 128, 64, 32, 16, 8, 4]
    shares = np.array([periods.count(p) for p in (256, 128, 64, 32, 16, 8)]) / 1000
    np.testing.assert_allclose(shares, 1 / 7, atol=2e-3)  # log-linear: each power for an equal share of the training
    assert period(-0.1) == 512 and period(1.1) == 4


def test_the_stages_of_a_default_training_are_those_of_the_table() -> None:
    at = lambda stage, p: float(stage(jnp.float32(p)))  # noqa: E731
    among, blank = (Schedule(of_kinds(load_config(), [kind])) for kind in ("surroundings", "blank"))
    assert [among.rules_out_cells(p) for p in (0.03, 0.04)] == [False, True] and blank.rules_out_cells(0.0)
    assert [at(among.by_share, p) for p in (0.2, 0.35, 0.5, 0.6)] == pytest.approx([0, 0.5, 1, 1])
    assert at(among.bias, 0.4) == 0 < at(among.bias, 0.45) < at(among.bias, 0.51) == at(blank.bias, 0.0) == 1
    assert at(among.fog, 0.19) == 0 < at(among.fog, 0.21) and at(blank.fog, 0.5) == 0
    assert at(blank.gain, 0.02) == 0 < at(blank.gain, 0.11) < at(blank.gain, 0.2) == at(blank.gain, 1.0) == GAIN
    np.testing.assert_allclose([at(among.hollowness, p) for p in (0.08, 0.18)], [0, 0.1])
    for schedule in (among, blank):
        np.testing.assert_allclose([at(schedule.density_normals, p) for p in (0.4, 0.6, 0.8)], [0.1, 0.3, 0.5], rtol=1e-6)
        np.testing.assert_allclose([at(schedule.blur, p) for p in (0, 0.8, 1)], [0.02, 0.002, 0.002], rtol=1e-5)
        np.testing.assert_allclose([at(schedule.pose_rate, p) for p in (0.1, 1)], [0, 0.001], rtol=1e-5)
