"""A turntable's axis, found in the cameras' orientations alone.

Where an object turned before a camera that stood still, any two views differ by a rotation about the same axis of the object's
frame. With the camera at several heights that is so within each ring of views.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from koala3d.datasets.turntable import before_turntable

PAIRS = 2000
"""Pairs of views that are compared, at most."""
LEAST, MOST = np.deg2rad([5.0, 175.0])
"""Angles between views that tell an axis."""
ALIKE = np.deg2rad(1.0)
"""Difference of axes, and of views of one ring turned back, below which they count as equal."""
FELLOWS = 3
"""Other views that belong to a ring, at least."""


@dataclass(frozen=True)
class Turning:
    """An axis and how well views agree with it."""

    axis: Float[np.ndarray, " 3"]
    """Unit, in the scene; upwards in most pictures."""
    agreeing: float
    """Share of the pairs of views that differ by a rotation about it."""
    on_rings: float
    """Share of the views that are the same as several others but for a rotation about it."""


def turning(rotations: Float[np.ndarray, "views 3 3"]) -> Turning | None:
    """The axis about which most pairs of views are turned; None where no two views tell one.

    Args:
        rotations: scene_from_camera.
    """
    first, second = np.triu_indices(len(rotations), 1)
    chosen = np.random.default_rng(0).permutation(len(first))[:PAIRS]
    relative = rotations[first[chosen]] @ np.swapaxes(rotations[second[chosen]], -1, -2)
    vectors = Rotation.from_matrix(relative).as_rotvec()
    angles = np.linalg.norm(vectors, axis=-1)
    told = (angles > LEAST) & (angles < MOST)
    if not told.any():
        return None
    axes = vectors[told] / angles[told, None]
    alike = np.abs(axes @ axes.T) > np.cos(ALIKE)
    best = int(alike.sum(1).argmax())
    fellows = axes[alike[best]]
    axis = (fellows * np.sign(fellows @ axes[best])[:, None]).sum(0)
    axis = axis / np.linalg.norm(axis)
    axis = axis * (1.0 if np.sum(rotations[:, :, 1] @ axis) <= 0 else -1.0)  # y is down
    return Turning(axis, float(alike[best].mean()), _on_rings(rotations, axis))


def _on_rings(rotations: Float[np.ndarray, "views 3 3"], axis: Float[np.ndarray, " 3"]) -> float:
    room_from_camera = before_turntable(axis, rotations) @ rotations
    trace = np.einsum("aij,bij->ab", room_from_camera, room_from_camera)
    fellows = (trace > 1 + 2 * np.cos(ALIKE)).sum(1) - 1
    return float(np.mean(fellows >= FELLOWS))
