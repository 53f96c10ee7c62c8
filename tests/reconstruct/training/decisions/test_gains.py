from dataclasses import replace

import numpy as np
import pytest

from koala3d.datasets.scene import Scene
from koala3d.datasets.structure.exposure import ExposureGains
from koala3d.reconstruct.training.decisions.evidence.gains import Differences


def differing(log: list[float], std: float = 0.01) -> Differences:
    """A median view and one with these log gains."""
    return Differences(ExposureGains(("a", "b"), np.array([[0.0] * 3, log]), np.full((2, 3), std), np.array([500, 500])))


@pytest.mark.parametrize(("log", "std", "needed"), [
    ([0.6, 0.6, 0.6], 0.01, "exposure"),
    ([-0.6, -0.6, -0.6], 0.01, "exposure"),
    ([0.2, 0.2, 0.2], 0.01, "none"),  # shading
    ([0.6, 0.6, 0.6], 0.09, "none"),  # matches contradict each other
    ([0.2, 0.0, -0.1], 0.01, "colour"),
    ([0.2, 0.0, -0.1], 0.05, "none"),
    ([0.7, 0.6, 0.4], 0.01, "colour"),
])  # fmt: skip
def test_what_is_learned_follows_what_surely_differs(log: list[float], std: float, needed: str) -> None:
    assert differing(log, std).needed == needed


def test_the_sentence_has_the_figures() -> None:
    words = differing([0.7, 0.6, 0.4]).words()
    assert words == (
        "1 of 2 views are brighter or darker than the median view (1.00 to 1.76 times its light), 1 have another white balance"
    )


def test_views_that_were_not_compared_start_at_the_median(ball_scene: tuple[Scene, object]) -> None:
    views = ball_scene[0].views[:3]
    log = np.array([[0.1, 0.2, 0.3], [np.nan, 0.5, 0.5]])
    found = Differences(ExposureGains((views[2].name, views[0].name), log, np.full((2, 3), 0.01), np.array([9, 9])))
    np.testing.assert_array_equal(found.log_gains_of(tuple(views)), [[0] * 3, [0] * 3, [0.1, 0.2, 0.3]])
    assert list(found.known) == [True, False] and found.needed == "none"


def test_without_matches_nothing_is_needed() -> None:
    nothing = replace(differing([0.0] * 3).gains, log_gains=np.full((2, 3), np.nan), std=np.full((2, 3), np.nan))
    assert Differences(nothing).needed == "none" and Differences(nothing).words() == "too few points were matched"
