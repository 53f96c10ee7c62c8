"""Inverse kinematics of the UR family in closed form, for platforms without EAIK.

The arm has Denavit-Hartenberg lengths d1, a2, a3, d4, d5, d6 and twists 90, 0, 0, 90, -90, 0 degrees: axes 2, 3 and 4 are
parallel, which decouples the problem (K. Hawkins, "Analytic inverse kinematics for the Universal Robots UR-5/UR-10 arms", 2013).
The wrist centre gives q1, the components of the tool's axes along axis 2 give q5 and q6, and a planar triangle gives q2, q3 and
q4: up to 2 x 2 x 2 branches.
"""

from collections.abc import Iterator
from math import acos, atan2, cos, hypot, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.kinematics import Links

Array = NDArray[np.float64]
ROUNDING = 1e-9
"""By this much a cosine may exceed 1, or a squared length [m^2] fall below 0, before the pose counts as out of reach."""


def branches(base_from_flange: Array, links: Links) -> Array:
    """(n, 6) joint angles [rad] of every branch that reaches the (4, 4) pose with nominal UR links; n = 0: out of reach.

    Where the wrist is straight (sin q5 = 0) only q4 + q6 or q4 - q6 is determined: q6 is taken as 0,
    and there is no branch where the elbow cannot reach that.
    """
    d1, _, _, d4, d5, d6 = links.d.tolist()
    x, y, z, flange = (base_from_flange[:3, column].tolist() for column in range(4))
    wrist = [flange[row] - d6 * z[row] for row in range(3)]
    found = []
    for q1 in _shoulder(wrist, d4):
        s1, c1 = sin(q1), cos(q1)
        along_x, along_y, along_z = (s1 * axis[0] - c1 * axis[1] for axis in (x, y, z))  # components along axis 2
        s5 = hypot(along_x, along_y)
        for sign in (1.0, -1.0):
            q5 = atan2(sign * s5, along_z)
            q6 = atan2(-sign * along_y, sign * along_x) if s5 > ROUNDING else 0.0
            # Against the axis of joint 5, along which d5 is measured: the flange's y axis turned back by q6.
            fifth = [sin(q6) * x[row] + cos(q6) * y[row] for row in range(3)]
            joint4 = [wrist[row] + d5 * fifth[row] for row in range(3)]
            in_plane = c1 * joint4[0] + s1 * joint4[1], joint4[2] - d1
            angle = atan2(-c1 * fifth[0] - s1 * fifth[1], fifth[2])  # q2 + q3 + q4
            found += [(q1, q2, q3, angle - q2 - q3, q5, q6) for q2, q3 in _elbow(*in_plane, *links.a.tolist()[1:3])]
    return np.array(found, np.float64).reshape(-1, 6)


def _shoulder(wrist: list[float], d4: float) -> Iterator[float]:
    """q1 for which the wrist centre is d4 beside the plane of the upper arm."""
    distance = hypot(wrist[0], wrist[1])
    if distance * (1 + ROUNDING) < d4 or distance == 0:
        return
    direction, aside = atan2(wrist[1], wrist[0]) + pi / 2, acos(min(d4 / distance, 1.0))
    yield direction + aside
    yield direction - aside


def _elbow(x: float, y: float, a2: float, a3: float) -> Iterator[tuple[float, float]]:
    """(q2, q3) of two links in the plane whose end is at (x, y); half angles keep accuracy where the arm is stretched."""
    squared = x * x + y * y
    short, spare = squared - (a2 - a3) ** 2, (a2 + a3) ** 2 - squared
    if min(short, spare) < -ROUNDING:
        return
    bend = 2 * atan2(sqrt(max(spare, 0.0)), sqrt(max(short, 0.0)))
    for q3 in (bend, -bend):
        q2 = atan2(y, x) - atan2(a3 * sin(q3), a2 + a3 * cos(q3))
        yield q2, q3
