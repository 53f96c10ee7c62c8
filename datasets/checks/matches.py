"""Poses compared with the images: features matched between neighbouring views, independent of the poses.

Poses are often stored in the wrong convention: the one that explains most matches is probably the right one. Where the given
poses are right in general, one check per cause follows, each a function `find(evidence)`. Errors that all views share come first,
and what follows is judged with them corrected.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.checks import arm, blur, box, exposure, intrinsics, light, masks, motion, single_poses
from koala3d.datasets.checks.evidence import VIEWS, Evidence
from koala3d.datasets.conventions import OPENCV_FROM_LLFF, OPENCV_FROM_MITSUBA, OPENCV_FROM_OPENGL
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.core.findings import Finding
from koala3d.datasets.scene import Scene
from koala3d.datasets.structure.triangulate import DOUBTFUL, agreement

FEWEST = 150
"""With fewer matches, poses are not judged."""
CLEARLY = 0.1
"""Another convention must explain twice as many matches, and more by this share of all."""
CHECKS = (single_poses, exposure, light, blur, motion, box)
"""Modules whose `find` looks at matches, in the order of their findings."""

CONVENTIONS: dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = {
    "OpenGL camera axes (y up, z back) taken for OpenCV's": lambda m: m @ OPENCV_FROM_OPENGL,
    "camera_from_world taken for world_from_camera": pose.inverse,
    "camera_from_world with OpenGL axes taken for world_from_camera": lambda m: pose.inverse(OPENCV_FROM_OPENGL @ m),
    "LLFF's axes (down, right, back) taken for OpenCV's": lambda m: m @ OPENCV_FROM_LLFF,
    "LLFF's axes taken for OpenGL's": lambda m: m @ OPENCV_FROM_OPENGL @ OPENCV_FROM_LLFF,
    "Mitsuba's axes (left, up, forward) taken for OpenGL's": lambda m: m @ OPENCV_FROM_OPENGL @ OPENCV_FROM_MITSUBA,
    "rotations transposed": lambda m: pose.rigid(np.swapaxes(m[..., :3, :3], -1, -2), m[..., :3, 3]),
}
"""Common mistakes, and the correction of each."""


def check_matches(scene: Scene, *, views_used: int = VIEWS) -> list[Finding]:
    """Findings from the pictures; those that need matches are left out where too little can be matched."""
    try:
        evidence = Evidence.gather(scene, count=views_used)
    except KoalaError:
        return []  # an unreadable image is a finding of its own
    return check_evidence(evidence)


def check_evidence(evidence: Evidence) -> list[Finding]:
    """The same of evidence that is there already."""
    if evidence.matches.count < FEWEST:
        return masks.find(evidence)
    wrong_convention = _convention(evidence)
    if wrong_convention:
        return wrong_convention
    found, evidence = arm.find(evidence)
    if any(one.cause == arm.SCALE for one in found):
        return found  # box and depths are of the wrong scale too
    if not found and (found := intrinsics.find(evidence)):
        evidence = intrinsics.without_error(evidence)
    elif not found and agreement(evidence.matches, evidence.matrices) < DOUBTFUL:
        shares = f"{100 * agreement(evidence.matches, evidence.matrices):.0f}% of {evidence.matches.count} matches agree"
        remedy = "check poses, intrinsics and the order of images"
        what = "poses do not explain the pictures"
        return [Finding("warning", what, evidence.scene.name, f"{shares} with the poses", remedy, "pose")]
    found += [finding for check in CHECKS for finding in check.find(evidence)]
    return [*found, *masks.find(evidence)]


def _convention(evidence: Evidence) -> list[Finding]:
    matches, matrices = evidence.matches, evidence.matrices
    given = agreement(matches, matrices)
    changes = CONVENTIONS | arm.conventions(evidence.scene)
    others = {name: agreement(matches, change(matrices)) for name, change in changes.items()}
    best = max(others, key=lambda name: others[name])
    if others[best] <= max(given + CLEARLY, 2 * given):
        return []
    why = f"{100 * given:.0f}% of {matches.count} matches agree with the poses"
    why += f", {100 * others[best]:.0f}% after correcting: {best}"
    remedy = "convert the poses where they are written"
    return [Finding("error", "poses follow another convention", evidence.scene.name, why, remedy, "pose")]
