"""Which cameras turn enough for all parameters of their lens."""

from collections.abc import Callable

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.process.poses.mapping import LEAST_TURN, second_turn


def test_turns_about_one_axis_have_no_second() -> None:
    turns = [pose.from_rotation_vector(angle * np.array([0.6, 0.0, 0.8]))[:3, :3] for angle in np.linspace(0, 2, 9)]
    assert second_turn(turns) < 1e-9


def test_turns_about_two_axes_are_measured() -> None:
    """Of four pictures, two are tilted by 0.2 against the others: four of six pairs differ by that."""
    turns = [pose.from_rotation_vector([tilt, 0, 0])[:3, :3] @ pose.from_rotation_vector([0, 0, turn])[:3, :3]
             for tilt in (0, 0.2) for turn in (0, 0.001)]  # fmt: skip
    thrice = [*turns, *(pose.from_rotation_vector([0, 0, 1.0])[:3, :3] @ turn for turn in turns)]
    assert second_turn(turns) == pytest.approx(0.001 * np.sqrt(4 / 6), rel=0.01)
    assert second_turn(thrice) > 0.1


@pytest.mark.parametrize(("wave", "enough"), [(0.0, False), (0.05, False), (0.2, True)])
def test_a_circle_at_one_height_is_not_enough(ring_of: Callable, wave: float, enough: bool) -> None:
    assert (second_turn([matrix[:3, :3] for matrix in ring_of(12, wave=wave)]) >= LEAST_TURN) == enough
