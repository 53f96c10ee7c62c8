"""The next views to take: those that leave the least uncertainty of the hand-eye pose.

The information of a view is known before it is taken: it follows from its corners and from the arm's accuracy as shown by the
session. Candidates are drawn around the board, where the recorded views were. The one that lowers the uncertainty most is
chosen first, then the best one in addition to it (greedy A-optimal design; Pukelsheim 2006, chapter 6).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from koala3d.calib.advice.information import Knowledge, informations
from koala3d.calib.advice.patterns import Rig, ViewRange, viewpoints
from koala3d.calib.arrays import Array
from koala3d.calib.calibrate import Solution
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye.model import State
from koala3d.calib.intrinsics import projection
from koala3d.datasets import pose
from koala3d.datasets.calibration import UncertainPose
from koala3d.datasets.core import files

LEVER_M = 0.4  # rotation errors are weighed by the motion they cause at this distance, that of the object from the camera
CANDIDATES = 400
MAX_TILT_DEG = 50.0


@dataclass(frozen=True)
class NextViews:
    """Views to take next, the most useful first."""

    base_from_camera: Array  # (n, 4, 4)
    before: tuple[float, float]  # standard deviation of the hand-eye pose now (translation [mm], rotation [deg]), over all axes
    after: tuple[tuple[float, float], ...]  # the same after each view, expected


def plan(solution: Solution, count: int, *, reach: Array | None = None, grow_m: float = 0.05, seed: int = 0) -> NextViews:
    """The next `count` views after a session that has been solved.

    The camera stays inside `reach`, a (2, 3) box in the base frame [m]; by default that of the recorded views, larger by `grow_m`
    on every side. Raises CalibrationError where no view within reach shows the board, and for a camera beside the arm.
    """
    fit = solution.fit
    if fit.session.eye_to_hand:
        raise CalibrationError("views are planned for a camera on the flange only", why="this one stands beside the arm")
    state = fit.refined.state
    flown = fit.session.base_from_flange @ state.mount_from_camera
    camera = projection.with_vector(solution.first.camera, state.intrinsics)
    rig = Rig(camera, fit.session.board, state.mount_from_camera, state.stand_from_board)
    recorded = np.stack([flown[:, :3, 3].min(0) - grow_m, flown[:, :3, 3].max(0) + grow_m])
    candidates = _candidates(np.random.default_rng(seed), rig, flown, recorded if reach is None else reach)
    known = Knowledge(camera, rig.board, fit.measured.free, state, fit.refined.sigmas, fit.refined.information)
    told = informations(known, np.array(candidates).reshape(-1, 4, 4) @ pose.inverse(state.mount_from_camera))
    showing = [(view, information) for view, information in zip(candidates, told, strict=True) if information is not None]
    if not showing:
        raise CalibrationError("no view within reach shows the board", remedy="allow more room with --grow-mm")
    total, chosen, after = fit.refined.information, [], []
    for _ in range(count):
        scores = [_score(total + information, state) for _, information in showing]
        best, information = showing[int(np.argmin(scores))]
        total = total + information
        chosen.append(best)
        after.append(_deviations(total, state))
    return NextViews(np.stack(chosen), _deviations(fit.refined.information, state), tuple(after))


def _candidates(rng: np.random.Generator, rig: Rig, flown: Array, reach: Array) -> list[Array]:
    """Camera poses within reach, as far from the board as the recorded ones and tilted up to `MAX_TILT_DEG`."""
    in_board = pose.inverse(rig.base_from_board) @ flown
    distance = -in_board[:, 2, 3]
    distances = 0.8 * float(distance.min()), 1.2 * float(distance.max())
    pattern = ViewRange((0.0, MAX_TILT_DEG), distances, shift_m=0.25 * float(np.ptp(rig.board.points)))
    drawn = viewpoints(rng, rig, 20 * CANDIDATES, pattern)
    within = np.all((drawn[:, :3, 3] >= reach[0]) & (drawn[:, :3, 3] <= reach[1]), axis=1)
    return list(drawn[within][:CANDIDATES])


def _deviations(information: Array, state: State) -> tuple[float, float]:
    """Standard deviations of the hand-eye pose over all axes: translation [mm], rotation [deg]."""
    return UncertainPose(state.mount_from_camera, np.asarray(np.linalg.inv(information)[-12:-6, -12:-6], np.float64)).total_std


def _score(information: Array, state: State) -> float:
    """Expected squared displacement at the object [m^2]."""
    translation_mm, rotation_deg = _deviations(information, state)
    return (1e-3 * translation_mm) ** 2 + (LEVER_M * np.deg2rad(rotation_deg)) ** 2


def write_trajectory(path: Path, found: NextViews, manifest: dict[str, Any]) -> None:
    """Write the views as a trajectory file for 'capture plan' and 'capture run', with the other settings of the recording."""
    recorded = manifest.get("trajectory") or {}
    kept = {key: recorded[key] for key in ("camera", "motion", "safety", "target", "board") if recorded.get(key) is not None}
    parts = [(m[:3, 3].round(6).tolist(), pose.quaternion(m).round(9).tolist()) for m in found.base_from_camera]
    poses = [{"position": position, "quaternion_wxyz": quaternion} for position, quaternion in parts]
    name = f"{recorded.get('name', 'calibration')}_next"
    head = {"format": "koala-trajectory", "version": 1, "name": name, "views": [{"kind": "poses", "poses": poses}]}
    before, after = found.before, found.after[-1]
    comment = (
        f"# The {len(poses)} most informative views after those recorded. Standard deviation of the hand-eye pose now:\n"
        f"# {before[0]:.4f} mm, {before[1]:.5f} deg; expected with these views: {after[0]:.4f} mm, {after[1]:.5f} deg.\n"
    )
    files.write_text(path, comment + yaml.safe_dump({**head, **kept}, sort_keys=False, default_flow_style=None, width=130))
