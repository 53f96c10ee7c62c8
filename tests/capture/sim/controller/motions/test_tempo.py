import numpy as np
import pytest

from koala3d.capture.sim.controller.motions.tempo import Tempo


@pytest.mark.parametrize("tempo", [Tempo(0.2, 5.0, 1.0, 1.0), Tempo(0.2, 5.0, 1.0, 0.0, 0.3), Tempo(0.2, 5.0, 0.4, 1.0, 2.0)])
def test_phase_is_the_integral_of_the_rate(tempo):
    times = np.linspace(5.0, 9.0, 4001)
    rates = np.array([tempo.rate(now) for now in times])
    phases = np.array([tempo.phase(now) for now in times])
    assert phases[0] == 0.2 and rates[0] == tempo.first and rates[-1] == tempo.last
    np.testing.assert_allclose(
        np.diff(phases), (rates[1:] + rates[:-1]) / 2 * 1e-3, atol=4e-4 * 1e-3
    )  # one step holds the corner


def test_stands_once_it_has_slowed_down_for_good():
    slowing, gathering = Tempo(0.0, 1.0, 1.0, 0.0, 0.5), Tempo(0.0, 1.0, 0.0, 1.0, 0.5)
    assert [slowing.stopped(now) for now in (1.0, 1.4, 1.5, 9.0)] == [False, False, True, True]
    assert not gathering.stopped(1.0)  # it is about to move
