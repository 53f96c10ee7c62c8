"""An order of the views with short paths between them."""

import numpy as np
from numpy.typing import NDArray

TURN_M = 0.4  # a turn of the view axis by one radian costs as much as a path of this length [m]


def short_order(base_from_camera: NDArray[np.float64]) -> list[int]:
    """Indices of (n, 4, 4) camera poses [m] in an order with a short path through all of them. The first stays first.

    Nearest neighbours, then 2-opt (Croes 1958): a section is reversed wherever that shortens the path.
    """
    places, axes = base_from_camera[:, :3, 3], base_from_camera[:, :3, 2]
    turn = np.arccos(np.clip(axes @ axes.T, -1, 1))
    cost = np.linalg.norm(places[:, None] - places[None], axis=-1) + TURN_M * turn
    order, left = [0], set(range(1, len(cost)))
    while left:
        order.append(min(left, key=lambda index: (cost[order[-1], index], index)))
        left.remove(order[-1])
    improved = True
    while improved:
        improved = False
        for first in range(1, len(order) - 1):
            for last in range(first + 1, len(order)):
                before, after = order[first - 1], order[last + 1] if last + 1 < len(order) else None
                old = cost[before, order[first]] + (0.0 if after is None else cost[order[last], after])
                new = cost[before, order[last]] + (0.0 if after is None else cost[order[first], after])
                if new < old - 1e-9:
                    order[first : last + 1] = order[first : last + 1][::-1]
                    improved = True
    return order
