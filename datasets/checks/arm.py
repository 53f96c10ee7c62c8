"""Errors of scenes whose poses come from an arm, world_from_camera = base_from_flange @ flange_from_camera: what all views share.

A wrong hand-eye pose moves every camera by the same in its own axes, a wrong latency along its own speed, and a wrong scale moves
the flange and not the camera on it. Which of them makes the matches agree best is probably the cause. Large mistakes are tried as
they are made: poses inverted, millimetres taken for metres.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.checks import intrinsics
from koala3d.datasets.checks.evidence import Evidence
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.core.findings import Finding
from koala3d.datasets.scene import Scene
from koala3d.datasets.structure import epipolar
from koala3d.datasets.structure.epipolar import CLOSE, WIDTHS, Correction, Pairs
from koala3d.datasets.track import SPEEDS, exponential

Array = NDArray[np.float64]
LEAST_PX, LEAST_BETTER = 0.3, 0.7
"""The median distance of right matches must fall by so much [px of the image that was searched], and to this share of itself."""
LEAST_GAIN = 0.1
"""Share of the matches' robust cost that the correction must remove. Three untouched scenes of shiny objects reach 0.002."""
STANDS_OUT = 5.0
"""So many standard deviations the change must be from none."""
FACTORS = (1.0, 1e-3, 1e3)
"""Scales from which the search for one begins: metres and millimetres may be mistaken for each other."""
SIMPLER = 0.02
"""A cause may explain less by this share for each parameter that it has less: six explain a little of everything."""
SCALE = "scale"
WHAT = {
    "latency": "the pictures' time stamps are later than stated",
    "hand-eye": "hand-eye pose does not fit the pictures",
    SCALE: "the arm's positions and the hand-eye pose differ in scale",
}
REMEDY = {
    "latency": "calibrate with a bag in which the arm moves while the board is in view: 'calib handeye' measures the latency",
    "hand-eye": "calibrate again with 'calib handeye': the camera or its bracket was moved, or the frames are others",
    SCALE: "check the unit of the arm's positions",
}


def hand_eye(scene: Scene) -> Array | None:
    """(4, 4) flange_from_camera that the poses of a scene were made with [m]; None where it is not stated."""
    stated = scene.provenance.get("flange_from_camera")
    try:
        return None if stated is None else pose.from_quaternion(stated["quaternion_wxyz"], stated["translation_m"])
    except (TypeError, KeyError, ValueError, DatasetError):
        return None


def conventions(scene: Scene) -> dict[str, Callable[[Array], Array]]:
    """Mistakes that are made with an arm's poses, and the correction of each; none where the scene is not an arm's."""
    mount = hand_eye(scene)
    if mount is None:
        return {}
    back = pose.inverse(mount)

    return {
        "hand-eye: camera_from_flange taken for flange_from_camera": lambda m: m @ back @ back,
        "scale: the arm's positions in millimetres, the hand-eye pose in metres": lambda m: _short(m @ back, 1e-3) @ mount,
        "scale: the arm's positions in metres, the hand-eye pose in millimetres": lambda m: _short(m @ back, 1e3) @ mount,
        "inverted: flange_from_base taken for base_from_flange": lambda m: pose.inverse(m @ back) @ mount,
    }


@dataclass(frozen=True, eq=False)
class Fault:
    """A cause with the change of its parameters that helps most."""

    cause: str
    fit: Correction
    matrices: Array
    """(views, 4, 4) poses after the correction."""
    far: bool = False
    """Whether the search began elsewhere than at the poses as they are."""

    def scale(self, evidence: Evidence) -> float:
        """By how much the correction enlarges the ways between the cameras' flanges."""
        mount = hand_eye(evidence.scene)
        assert mount is not None
        after, before = (np.ptp((m @ pose.inverse(mount))[:, :3, 3], axis=0) for m in (self.matrices, evidence.matrices))
        return float(np.linalg.norm(after) / max(np.linalg.norm(before), 1e-12))

    @property
    def counts(self) -> bool:
        """Whether it is worth to be named."""
        fit = self.fit
        certain = self.far or bool((np.abs(fit.change) > STANDS_OUT * fit.std).any())
        better = fit.before_px - fit.after_px > LEAST_PX and fit.after_px < LEAST_BETTER * fit.before_px
        return certain and better and fit.gain > LEAST_GAIN


def best(evidence: Evidence) -> Fault | None:
    """The one cause that helps the matches most; None where none is worth to be named, or the scene is not an arm's."""
    mount = hand_eye(evidence.scene)
    if mount is None:
        return None
    pairs, depth = _drawn(evidence.pairs), float(np.median([evidence.depth(view) for view in range(len(evidence.views))]))
    pixel = float(np.median(pairs.pixel))
    flanges = evidence.matrices @ pose.inverse(mount)
    reach = max(float(np.linalg.norm(mount[:3, 3])), 1e-6)
    changes: list[tuple[str, Callable[[Array], Array], list[float]]] = [
        ("hand-eye", lambda x: evidence.matrices @ exponential(x[None]), [pixel * depth] * 3 + [pixel] * 3),
        *((SCALE, partial(_scaled, flanges, mount, factor), [pixel * depth / reach]) for factor in FACTORS),
    ]
    if (speeds := _speeds(evidence)) is not None:
        shift = np.linalg.norm(speeds[:, :3], axis=1) / depth + np.linalg.norm(speeds[:, 3:], axis=1)
        step = pixel / max(float(np.median(shift)), 1e-9)
        changes.append(("latency", lambda x: evidence.matrices @ exponential(-x[0] * speeds), [step]))
    found = [_fitted(evidence, pairs, *change) for change in changes]
    named = [fault for fault in found if fault.counts]
    return max(named, key=lambda fault: fault.fit.gain - SIMPLER * len(fault.fit.change), default=None)


def _fitted(evidence: Evidence, pairs: Pairs, cause: str, change: Callable[[Array], Array], steps: list[float]) -> Fault:
    """The best change of one cause, compared with the poses as they are."""
    fit = epipolar.corrected(lambda x: pairs.distances(change(x)), steps, damping=1e-4, widths=(64.0, 32.0, *WIDTHS, *CLOSE))
    matrices = change(fit.change)
    before, after = pairs.distances(evidence.matrices), pairs.distances(matrices)
    right = np.abs(after) < epipolar.INLIER_PX
    median = float(np.median(np.abs(before[right]))) if right.any() else np.inf
    gain = 1 - epipolar.cost(after, CLOSE[-1]) / max(epipolar.cost(before, CLOSE[-1]), 1e-12)
    far = not np.allclose(change(np.zeros(len(steps))), evidence.matrices)
    return Fault(cause, replace(fit, gain=gain, before_px=median), matrices, far)


def _scaled(flanges: Array, mount: Array, factor: float, change: Array) -> Array:
    """(views, 4, 4) poses with positions of the flange `factor` times as large, and exp(change[0]) times that."""
    return _short(flanges, factor * float(np.exp(np.clip(change[0], -3, 3)))) @ mount


def _short(matrix: Array, factor: float) -> Array:
    """Poses with scaled positions."""
    return pose.rigid(matrix[..., :3, :3], factor * matrix[..., :3, 3])


def _speeds(evidence: Evidence) -> Array | None:
    """(views, 6) speed of the camera at each view, in its own axes; None where the scene does not state it."""
    stated = evidence.scene.provenance.get(SPEEDS)
    if not isinstance(stated, dict) or any(view.name not in stated for view in evidence.views):
        return None
    speeds = np.array([stated[view.name] for view in evidence.views], np.float64)
    return speeds if speeds.shape == (len(evidence.views), 6) and np.isfinite(speeds).all() else None


def _drawn(pairs: Pairs) -> Pairs:
    count = len(pairs.first)
    if count <= intrinsics.MATCHES:
        return pairs
    return pairs.at(np.random.default_rng(0).choice(count, intrinsics.MATCHES, replace=False))


def find(evidence: Evidence) -> tuple[list[Finding], Evidence]:
    """One finding where an error that an arm's poses share explains more than one of the camera; and the evidence without it."""
    fault = best(evidence)
    if fault is None or fault.fit.gain < intrinsics.best(evidence)[2].gain:
        return [], evidence
    fit = fault.fit
    if fault.cause == "latency":
        words = f"with a latency that is {1e3 * fit.change[0]:.1f} ± {1e3 * fit.std[0]:.1f} ms larger"
    elif fault.cause == SCALE:
        words = f"with positions of the arm that are {fault.scale(evidence):.4g} times as large"
    else:
        move_mm, turn_deg = 1e3 * np.linalg.norm(fit.change[:3]), np.rad2deg(np.linalg.norm(fit.change[3:]))
        words = f"with a camera that is moved by {move_mm:.2g} mm and turned by {turn_deg:.2g} deg on the flange"
    why = f"{words}, the median distance of {fit.inliers} matches from their epipolar lines falls from"
    why += f" {fit.before_px:.2f} to {fit.after_px:.2f} px"
    figures: dict[str, Any] = {"change": fit.change.tolist(), "std": fit.std.tolist()}
    figures |= {"scale": fault.scale(evidence)} if fault.cause == SCALE else {}
    found = Finding("warning", WHAT[fault.cause], "all views", why, REMEDY[fault.cause], fault.cause, figures)
    return [found], replace(evidence, matrices=fault.matrices)
