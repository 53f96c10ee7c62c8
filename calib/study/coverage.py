"""How often the stated 95 % region holds the truth, on arms with and without errors that repeat.

A rig of a seed differs from the drawing (`calib.study.rehearsal.draw_rig`). Its arm is built `scale` times 0.5 mm and
0.05 degrees off the links that its controller believes in, in every parameter and the same in all views. Corners have 0.1 px of
noise and the arm stops within 0.03 mm and 0.005 degrees per axis. Everything is estimated as by `calib handeye`. The truth is
the camera's pose on the true flange.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from koala3d.calib import calibrate
from koala3d.calib.arrays import Array
from koala3d.calib.handeye import repeating
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.solver.geometry import rms_difference
from koala3d.calib.study.rehearsal import ARM, SIGMA_PX, draw_rig
from koala3d.calib.study.simulate import Pattern, Rig, simulate, viewpoints
from koala3d.calib.study.variants import target_session
from koala3d.datasets import kinematics, pose
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.kinematics import UR5E, Links

PATTERN = Pattern((20.0, 50.0), (0.3, 0.5))
POSTURE = np.array([0.3, -1.8, 1.9, -1.6, -1.5, 0.5])  # near which the arm takes its views [rad]
ALONE = 40  # views of the session that intrinsics come from where they come from another
ATTEMPTS, STEPS, EXACT = 12, 25, 1e-9  # postures that are tried, Newton steps from each, largest distance left [m, rad]


@dataclass(frozen=True)
class Condition:
    """A kind of session."""

    scale: float  # of the errors of the links, in units of 0.5 mm and 0.05 degrees
    separate: bool = False  # whether intrinsics come from another session
    angles: bool = True  # whether joint angles are recorded
    views: int = 25


CONDITIONS = (
    Condition(0.0),
    Condition(1.0),
    Condition(0.0, separate=True),
    Condition(1.0, separate=True),
    Condition(0.2),
    Condition(0.0, angles=False),
    Condition(1.0, angles=False),
    Condition(0.0, views=12),
    Condition(1.0, views=12),
)


@dataclass(frozen=True)
class Outcome:
    """The rigs of one condition, a row each; (translation [mm], rotation [deg]) where there are two columns."""

    condition: Condition
    errors: Array  # (rigs, 2)
    stated: Array  # (rigs, 2) standard deviations over all axes
    distances: Array  # (rigs, 2) squared error in units of the stated covariance: of the camera's pose, of the board's
    failures: int

    @property
    def coverage(self) -> tuple[float, float]:
        """Share of the rigs whose 95 % region holds the true pose of the camera, and of the board."""
        camera, board = (self.distances < chi2.ppf(0.95, 6)).mean(0)
        return float(camera), float(board)


def run(conditions: Sequence[Condition], rigs: int, seed: int, done: Callable[[], None] = lambda: None) -> Iterator[Outcome]:
    """Measure each condition on so many rigs. `done` is called after each rig."""
    for condition in conditions:
        rows, failures = [], 0
        for number in range(rigs):
            try:
                rows.append(once(condition, seed + number))
            except KoalaError:
                failures += 1
            done()
        table = np.array(rows).reshape(-1, 6)
        yield Outcome(condition, table[:, :2], table[:, 2:4], table[:, 4:], failures)


def once(condition: Condition, seed: int) -> Array:
    """(6,) error and stated deviation [mm], [deg], and both squared distances of one rig."""
    rng, rig = np.random.default_rng([seed, 51]), draw_rig(seed)
    links = UR5E.calibrated(rng, condition.scale * repeating.LENGTH_M, condition.scale * repeating.ANGLE_RAD)
    given = None
    if condition.separate:
        flown = viewpoints(rng, rig, ALONE, PATTERN)
        given = calibrate.calibrate_intrinsics(target_session(simulate(rng, rig, flown, sigma_px=SIGMA_PX, arm=ARM), "alone"))
    session = drawn(rng, rig, links, condition.views)
    found = calibrate.calibrate_handeye(session if condition.angles else replace(session, joints=None), given)
    return judged(found, rig)


def judged(found: Calibration, rig: Rig) -> Array:
    """(6,) of `once`."""
    assert found.flange_from_camera is not None and found.base_from_board is not None  # the camera is on the flange
    camera, board = found.flange_from_camera, found.base_from_board
    distances = squared_distance(camera, rig.flange_from_camera), squared_distance(board, rig.base_from_board)
    return np.array([*rms_difference(rig.flange_from_camera, camera.matrix), *camera.total_std, *distances])


def squared_distance(stated: UncertainPose, truth: Array) -> float:
    """Squared error of a pose in units of its covariance (Mahalanobis)."""
    perturbation = truth @ pose.inverse(stated.matrix)
    error = np.concatenate([perturbation[:3, 3], pose.rotation_vector(perturbation)])
    return float(error @ np.linalg.solve(stated.covariance, error))


def drawn(rng: np.random.Generator, rig: Rig, links: Links, views: int, arm: Accuracy = ARM) -> TargetSession:
    """A session of an arm that is built with `links` and reports what those of the drawing give for its joint angles."""
    flown, angles = np.zeros((0, 4, 4)), np.zeros((0, links.count))
    while len(flown) < views:
        more = viewpoints(rng, rig, views, PATTERN)
        reached, good = solved(rng, more @ pose.inverse(rig.flange_from_camera), links)
        flown, angles = np.concatenate([flown, more[good]])[:views], np.concatenate([angles, reached[good]])[:views]
    simulated = simulate(rng, rig, flown, sigma_px=SIGMA_PX, arm=arm)
    # the true flange is at `links` after the stop's error: the angles that the arm reports lead there without it
    angles, _ = solved(rng, simulated.session.base_from_flange, links, angles)
    session = replace(simulated.session, base_from_flange=kinematics.forward(angles, UR5E))
    return replace(target_session(replace(simulated, session=session)), joints=angles)


def solved(rng: np.random.Generator, base_from_flange: Array, links: Links, start: Array | None = None) -> tuple[Array, Array]:
    """(n, 6) joint angles [rad] for (n, 4, 4) poses, and the mask (n,) of the poses that were reached.

    Newton's method from `start`, or from postures near `POSTURE` with any turn of the last joint.
    """
    angles = np.tile(POSTURE, (len(base_from_flange), 1)) if start is None else start
    for _ in range(ATTEMPTS):
        angles = _newton(base_from_flange, angles, links)
        left, turn = pose.difference(kinematics.forward(angles, links), base_from_flange)
        good = (left < EXACT) & (turn < EXACT) & (np.abs(angles) < 2 * np.pi).all(1)
        if good.all():
            break
        others = POSTURE + rng.normal(0, 0.4, angles.shape)
        others[:, -1] = rng.uniform(-np.pi, np.pi, len(angles))
        angles = np.where(good[:, None], angles, others)
    return angles, good


def _newton(base_from_flange: Array, angles: Array, links: Links) -> Array:
    """(n, 6) joint angles after some damped steps towards (n, 4, 4) poses."""
    for _ in range(STEPS):
        reached, rows = kinematics.forward(angles, links), kinematics.jacobian(angles, links)
        turn = pose.rotation_vector(base_from_flange @ pose.inverse(reached))
        off = np.concatenate([base_from_flange[:, :3, 3] - reached[:, :3, 3], turn], -1)
        across = np.swapaxes(rows, 1, 2)
        step = np.linalg.solve(across @ rows + 1e-9 * np.eye(rows.shape[-1]), across @ off[..., None])[..., 0]
        angles = angles + np.clip(step, -0.5, 0.5)
    return angles


def summary(outcome: Outcome) -> dict[str, Any]:
    """One condition as plain numbers; errors are root mean squares, stated deviations too."""
    root = [np.sqrt(np.mean(part**2, axis=0)) for part in (outcome.errors, outcome.stated)]
    camera, board = outcome.coverage
    names = ("error_mm", "error_deg", "stated_mm", "stated_deg")
    numbers = dict(zip(names, map(float, np.concatenate(root)), strict=True))
    counts = {"rigs": len(outcome.errors), "failures": outcome.failures}
    return {**vars(outcome.condition), **counts, "covered": camera, "board_covered": board, **numbers}


def markdown(outcomes: Sequence[Outcome]) -> str:
    """A table with one row per condition."""
    head = "links off by|intrinsics|joint angles|views|rigs|camera's pose covered|board's|rms error|stated"
    lines = [f"| {' | '.join(head.split('|'))} |", "|" + "---|" * 9]
    for outcome in outcomes:
        condition, s = outcome.condition, summary(outcome)
        links = f"{1e3 * repeating.LENGTH_M * condition.scale:g} mm, {np.rad2deg(repeating.ANGLE_RAD) * condition.scale:g}°"
        source = "of another session" if condition.separate else "of the session"
        cells = [links, source, "recorded" if condition.angles else "unknown", condition.views, s["rigs"]]
        cells += [f"{s['covered']:.0%}", f"{s['board_covered']:.0%}"]
        cells += [f"{s[f'{kind}_mm']:.3f} mm, {s[f'{kind}_deg']:.4f}°" for kind in ("error", "stated")]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines) + "\n"


def write(folder: Path, outcomes: Sequence[Outcome]) -> None:
    """Write coverage.json and coverage.md into a new folder."""
    content = {"format": "koala-coverage", "version": 1, "conditions": [summary(outcome) for outcome in outcomes]}
    with files.atomic_folder(folder) as temporary:
        files.write_json(temporary / "coverage.json", content)
        files.write_text(temporary / "coverage.md", markdown(outcomes))
