"""Targets are judged before anything moves."""

import numpy as np
import pytest

from koala3d.capture.drivers.errors import SafetyError
from koala3d.capture.drivers.safety import Limits


def test_a_sound_target_passes():
    np.testing.assert_array_equal(Limits().check([0, -1, 1, 0, 0, 6], 1.0, 1.0), [0, -1, 1, 0, 0, 6])


@pytest.mark.parametrize(
    ("joints", "speed", "acceleration", "expected"),
    [
        ([0, 0, 0, 0, 0], 1, 1, "6 finite"),
        ([0, 0, np.nan, 0, 0, 0], 1, 1, "6 finite"),
        ([0, 0, 7, 0, 0, 0], 1, 1, "joint 3 .*401 degrees, limit 360"),
        ([0] * 6, 1.2, 1, "speed .*1.2 rad/s, limit 1.05"),
        ([0] * 6, np.nan, 1, "speed"),
        ([0] * 6, 1, 0, "acceleration"),
    ],
)
def test_an_unsafe_target_names_its_limit(joints, speed, acceleration, expected):
    with pytest.raises(SafetyError, match=expected):
        Limits().check(joints, speed, acceleration)
