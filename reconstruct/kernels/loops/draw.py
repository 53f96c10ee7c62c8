"""Which of a ray's steps are drawn, as a compiled loop; see `draw_probability` and `draw` in `reconstruct.sampling.drawing`."""

import numpy as np

from koala3d.reconstruct.kernels.loops.along import at, exp_of_minus
from koala3d.reconstruct.kernels.loops.compiler import compiled, compiled_exactly

LEAST_IMPORTANCE = np.float32(0.02)
"""As in `reconstruct.sampling.drawing`."""
TINY, LEAST_SHARE = np.float32(1e-9), np.float32(1e-6)
f4, i4 = np.float32, np.int32


@compiled
def _find_importance(depth, steps, own, importance):
    """Steps with depth, their own depths, and how important each is; their number."""
    found = 0
    for step in range(depth.shape[0]):
        steps[np.uint64(found)], own[np.uint64(found)] = step, depth[step]
        found += np.int64(depth[step] > 0)
    before = f4(0)
    for i in range(found):
        importance[i] = before
        before += own[i]
    for i in range(found):
        importance[i] = exp_of_minus(importance[i]) * own[i] + LEAST_IMPORTANCE
    return found


@compiled
def _factor(importance, found, wanted):
    """From importance to probability, where it stays below one."""
    total, largest = f4(0), f4(0)
    for i in range(found):
        total += importance[i]
        largest = max(largest, importance[i])
    factor, before = wanted / max(total, TINY), f4(0)
    for _ in range(3):  # what is certain already leaves its share to the others
        if factor == before or largest * factor < f4(1):  # nothing would change any more
            break
        room, rest, before = wanted, f4(0), factor
        for i in range(found):
            certain = importance[i] * factor >= f4(1)
            room -= f4(certain)
            rest += f4(0) if certain else importance[i]
        factor = max(factor, room / max(rest, TINY))
    return factor


@compiled_exactly
def _draw(importance, found, factor, offset, steps, shares):
    """Put the drawn steps first in `steps`, their probabilities into `shares`; their number."""
    drawn, total, passed = 0, f4(0), f4(0)
    for i in range(found):
        share = min(importance[i] * factor, f4(1))
        total += share
        now = np.floor(total + offset)
        steps[np.uint64(drawn)], shares[np.uint64(drawn)] = steps[np.uint64(i)], share
        drawn += np.int64(now > passed)
        passed = now
    return drawn


@compiled
def draw_ray(depth, ray, cuts, choices, jitter, offset, steps, importance, shares, t, length):
    """Write t and length of a ray's samples, one less than there is room for where so many steps have depth; their number.

    The rest of the arguments are as in `along.at`, or room for a ray's steps: `steps`, `importance`, `shares`.
    """
    found = _find_importance(depth, steps, shares, importance)
    factor = _factor(importance, found, f4(t.shape[0] - 1))
    drawn = min(_draw(importance, found, factor, offset, steps, shares), t.shape[0])
    for slot in range(drawn):
        u = f4(steps[slot])
        t[slot] = at(u + jitter, cuts, ray, choices)
        extent = at(u + f4(1), cuts, ray, choices) - at(u, cuts, ray, choices)
        length[slot] = extent / max(shares[slot], LEAST_SHARE)
    return drawn
