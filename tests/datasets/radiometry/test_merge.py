from dataclasses import replace

import numpy as np
import pytest

from koala3d.datasets.radiometry.merge import SATURATED, merge
from koala3d.datasets.radiometry.response import Response

TIMES = (8.0, 1.0, 0.125)


def response(**changes) -> Response:
    return replace(Response.unmeasured(100, 100, (1, 1, 1)), **changes)


def readings(light: float, known: Response, seed: int = 0) -> list[np.ndarray]:
    """Three exposures of even light, in full pixels of the longest one."""
    rng, found = np.random.default_rng(seed), []
    for time in TIMES:
        signal = np.full((100, 100, 1), light * time / TIMES[0])
        noise = rng.normal(0, 1, signal.shape) * np.sqrt(known.read**2 + known.shot * np.minimum(signal, 1))
        values = known.black + (1 - known.black) * (np.minimum(signal, 1) + noise)
        found.append((np.rint(np.clip(values, 0, 1) * 4095) / 4095).astype(np.float32))
    return found


@pytest.mark.parametrize("light", [0.003, 0.1, 0.9, 4.0, 40.0])
def test_light_and_its_deviation_are_right(light):
    """Over 10 000 pixels: the mean within 4 standard errors, and the stated deviation within 5 % of the true one."""
    known = response(black=np.full((1, 1, 1), 0.02))
    merged = merge(readings(light, known), TIMES, known, raw=True)
    true = float(merged.signal.std())
    assert abs(merged.signal.mean() - light) < 4 * true / 100 + 1e-4 * light
    assert float(merged.deviation.mean()) == pytest.approx(true, rel=0.05)
    assert not merged.clipped.any()


def test_merging_is_less_noisy_than_the_longest_exposure():
    known = response()
    values = readings(0.5, known)
    merged = merge(values, TIMES, known, raw=True)
    assert merged.signal.std() < values[0].std()
    one = merge(values[:1], TIMES[:1], known, raw=True)
    assert one.deviation.mean() == pytest.approx(values[0].std(), rel=0.05)


def test_what_saturates_everywhere_is_a_bound():
    known = response(shot=1e-6)  # noise of 0.1 %: a full pixel does not look like one that is not
    merged = merge(readings(100.0, known), TIMES, known, raw=True)
    assert merged.clipped.all() and merged.signal.min() >= SATURATED * TIMES[0] / TIMES[-1]
