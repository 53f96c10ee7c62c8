"""Gains on a plate that few views see: small enough to be counted by hand."""

import numpy as np
import pytest

from koala3d.capture.sessions.adaptive import gain
from koala3d.capture.sessions.adaptive.gain import Seen
from koala3d.capture.sessions.adaptive.places import Places

PLATE = Places.of(np.array([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]]), np.tile([0.0, 0, 1], (3, 1)), np.array([1.0, 1, 2]), 1.0)
HIGH = 100.0  # of cameras: all places are seen from one direction


def seen(*rows: tuple[float, ...], tilt_deg: tuple[float, ...] = ()) -> Seen:
    """Views with the cosines of a row each, from so many degrees off the vertical."""
    tilts = np.radians(tilt_deg or np.zeros(len(rows)))
    eyes = HIGH * np.stack([np.sin(tilts), np.zeros_like(tilts), np.cos(tilts)], -1)
    return Seen(np.array(rows, np.float32).reshape(-1, 3), eyes.reshape(-1, 3))


def test_the_first_view_of_a_place_is_worth_most():
    candidates = seen((1, 0, 0), (1, 1, 0), (0.49, 0.49, 0.49))
    np.testing.assert_allclose(gain.surface_gains(PLATE, seen(), candidates), [0.125, 0.25, 0])  # 1/2 of shares 1/4 and 1/2
    np.testing.assert_allclose(gain.surface_gains(PLATE, seen((1, 0, 0)), candidates), [0.25 / 3, 0.25 / 3 + 0.125, 0])
    full = seen(*[(1, 1, 1)] * 3)
    assert not gain.surface_gains(PLATE, full, candidates).any()


def test_gains_of_three_views_add_up_to_all():
    taken, total = seen(), 0.0
    for _ in range(3):
        total += gain.surface_gains(PLATE, taken, seen((1, 1, 1)))[0]
        taken = Seen(np.concatenate([taken.facing, np.ones((1, 3), np.float32)]), np.concatenate([taken.eyes, [[0, 0, HIGH]]]))
    assert total == pytest.approx(1) and gain.coverage(PLATE, taken, seen()).covered == 1


def test_coverage_is_of_what_views_within_reach_can_cover():
    candidates = seen(*[(1, 1, 0)] * 3)
    found = gain.coverage(PLATE, seen(*[(1, 0, 0)] * 3), candidates)
    assert found.reachable == pytest.approx(0.5) and found.covered == pytest.approx(0.5)
    nothing = gain.coverage(PLATE, seen(), seen((1, 1, 1)))
    assert nothing.reachable == 0 and nothing.covered == 1


def angle_gains(changing: np.ndarray, taken: Seen, candidates: Seen) -> np.ndarray:
    ways = [gain.directions(PLATE.points, views.eyes) for views in (taken, candidates)]
    return gain.angle_gains(PLATE, changing, taken, candidates, gain.nearest_directions(ways[0], taken.well, ways[1]))


def test_a_new_direction_is_worth_something_where_the_colour_changes():
    changing, taken = np.array([1.0, 0.5, 0.0]), seen((1, 1, 1), tilt_deg=(0,))
    candidates = seen((1, 1, 1), (1, 1, 1), (1, 1, 1), (1, 0, 0), tilt_deg=(4, 40, 14, 40))
    found = angle_gains(changing, taken, candidates)
    assert found[0] == pytest.approx(0, abs=1e-3) and found[1] == pytest.approx(0.25 + 0.125, rel=1e-3)
    assert 0.2 * found[1] < found[2] < 0.8 * found[1] and found[3] == pytest.approx(0.25, rel=1e-3)
    unseen = angle_gains(changing, seen((0, 0, 0), tilt_deg=(0,)), candidates)
    assert not unseen.any(), "surface that no view has seen is counted as such"
    both = angle_gains(changing, seen((1, 1, 1), (1, 1, 1), tilt_deg=(0, 38)), candidates)
    assert both[1] == pytest.approx(0, abs=1e-3), "the nearest of the directions decides"
