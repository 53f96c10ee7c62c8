"""A scene of which one half says that the object was turned over before it."""

from dataclasses import replace

import numpy as np

from koala3d.datasets.scene import TURNED, Scene

SHIFT_M, TURN_RAD = 5e-4, 4e-3
"""Stated standard deviations of the motion along each axis."""


def of_two_sessions(scene: Scene, *, times: float = 1.0) -> Scene:
    """The scene, whose later training views and last test view are those of the second session.

    Args:
        times: so many times the standard deviations are stated.
    """
    names = [view.name for view in (*scene.split("train")[2:], scene.split("test")[-1])]
    covariance = times**2 * np.diag([SHIFT_M**2] * 3 + [TURN_RAD**2] * 3)
    middle, still = scene.box.mean(0).tolist(), np.eye(4).tolist()
    stated = {"views": names, "a_from_b": still, "middle": middle, "covariance": covariance.tolist()}
    return replace(scene, provenance={**scene.provenance, TURNED: stated})
