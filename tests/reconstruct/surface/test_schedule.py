import numpy as np

from koala3d.reconstruct.surface.second_pass import second_pass_period


def test_the_second_pass_s_period_falls_from_512_to_4_in_powers_of_two() -> None:
    periods = [second_pass_period(p, first=512, last=4) for p in np.linspace(0, 1, 1000)]
    assert list(dict.fromkeys(periods)) == [512, 256, 128, 64, 32, 16, 8, 4]
    shares = np.array([periods.count(p) for p in (256, 128, 64, 32, 16, 8)]) / 1000
    np.testing.assert_allclose(shares, 1 / 7, atol=2e-3)  # log-linear: each power for an equal share of the training
    assert second_pass_period(-0.1, first=512, last=4) == 512
    assert second_pass_period(1.1, first=2048, last=16) == 16
