"""How fast the parts of an arm move on a straight path in joint space, and what they sweep between two configurations on it.

On such a path the joint angles are start + s * change with s from 0 to 1. A point x that is fixed to link k moves by

    dx/ds = turn_k x x - moment_k,   turn_k = sum of change_i z_i,   moment_k = sum of change_i z_i x o_i   over joints i <= k

with the axes z_i and the origins o_i of the joints in the base. The fastest point of a capsule is on the ball around one end of
its axis, since the speed is convex along the axis.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.carrier import Carrier

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STEP_RAD = 0.02  # of the fastest joint, between two configurations at which speeds are measured
BETWEEN = 1.001  # by which a speed between two of them may exceed theirs; in 300 random moves of a UR5e it did by 7e-5


@dataclass(frozen=True, eq=False)
class Sweep:
    """Bodies whose motion counts.

    Args:
        parts: (k,) of `carrier.shape`, by their places.
        seen_from: (k,) link in whose frame each part's motion counts; 0: the base.
    """

    carrier: Carrier
    parts: Index
    seen_from: Index

    def speeds(self, joints: Array, change: Array) -> Array:
        """(m, k) speed of the fastest point of each part [m per unit of s], at (m, n) angles with (m, n) `change` [rad]."""
        frames, shape = self.carrier.frames(joints), self.carrier.shape
        turns, moments = (self._relative(one) for one in _screws(frames, change))
        ends = shape.segments(frames)[:, self.parts]
        velocity = np.cross(turns[:, :, None], ends) - moments[:, :, None]
        spin = np.linalg.norm(turns, axis=-1)
        axis = turns / np.maximum(spin, 1e-12)[..., None]
        along = (velocity * axis[:, :, None]).sum(-1)
        across = np.linalg.norm(velocity - along[..., None] * axis[:, :, None], axis=-1)
        return np.hypot(along, across + (spin * shape.radii[self.parts])[..., None]).max(-1)

    def _relative(self, of_links: Array) -> Array:
        links = np.array([self.carrier.shape.parts[part].link for part in self.parts])
        return np.asarray(of_links[:, links] - of_links[:, self.seen_from])

    def bends(self, change: Array) -> Array:
        """(m, k) bound on the second derivative [m per unit of s^2] of any point of each part, for (m, n) `change` [rad].

        With |o_i x| at most r_i at any angles, it is the sum of |change_i change_j| r_max(i, j) over the joints between.
        """
        links = np.array([self.carrier.shape.parts[part].link for part in self.parts])
        number = np.arange(change.shape[-1])
        low, high = np.minimum(links, self.seen_from), np.maximum(links, self.seen_from)
        turning = (number >= low[:, None]) & (number < high[:, None])
        moved = np.abs(change)[:, None] * turning
        pairs = self._radii[np.maximum(number[:, None], number[None])]
        return np.asarray(np.einsum("mki,ij,mkj->mk", moved, pairs, moved))

    @cached_property
    def _radii(self) -> Array:
        """(n,) distance [m] that no point of the body beyond joint i exceeds from the joint's origin, at any angles."""
        carrier, parts = self.carrier, self.carrier.shape.parts
        origins = carrier.frames(np.zeros(carrier.arm.count))[:, :3, 3]
        links = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(origins, axis=0), axis=-1))])  # each is rigid
        far = [max(np.linalg.norm(part.start), np.linalg.norm(part.end)) + part.radius for part in parts]
        reach = [
            max((links[part.link] + size - links[joint] for part, size in zip(parts, far, strict=True) if part.link > joint))
            for joint in range(carrier.arm.count)
        ]
        return np.array(reach)


def _screws(frames: Array, change: Array) -> tuple[Array, Array]:
    """(m, n + 1, 3) `turn` and `moment` of base and links."""
    axes, origins = frames[:, :-1, :3, 2], frames[:, :-1, :3, 3]
    turns = change[..., None] * axes
    both = [turns, np.cross(turns, origins)]
    first, second = (np.concatenate([np.zeros_like(one[:, :1]), np.cumsum(one, axis=1)], axis=1) for one in both)
    return first, second


def lever(start: Array, goal: Array, carrier: Carrier) -> float:
    """Speed of the body's fastest point on the straight path [m], for each radian that the fastest joint moves."""
    travel = float(np.abs(goal - start).max())
    if travel == 0:
        return 0.0
    joints = np.linspace(start, goal, int(np.ceil(travel / STEP_RAD)) + 1)
    everything = np.arange(len(carrier.shape.parts))
    speeds = Sweep(carrier, everything, np.zeros_like(everything)).speeds(joints, np.broadcast_to(goal - start, joints.shape))
    return BETWEEN * float(speeds.max()) / travel
