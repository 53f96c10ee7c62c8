"""What makes a calibration session good: the simulated Koala rig, with one thing changed at a time.

Every session is processed as by `calib handeye`: intrinsics from the corners, closed form, refinement.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from koala3d.calib import calibrate
from koala3d.calib.arrays import Array
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import closed_forms
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.intrinsics import estimate
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.solver.geometry import rms_difference
from koala3d.calib.study import next_views
from koala3d.calib.study.simulate import KOALA, Pattern, Rig, Simulated, simulate, viewpoints
from koala3d.datasets.targets.board import Board

SIGMA_PX = 0.1
ARM = Accuracy(3e-5, float(np.deg2rad(0.005)))  # per axis: what a UR5e repeats to
USUAL = Pattern()
AIM = (0.05, 0.012)  # median error wanted (translation [mm], rotation [deg])


@dataclass(frozen=True)
class Variant:
    """One way to record a session."""

    name: str
    rig: Rig
    pattern: Pattern = USUAL
    views: int = 25
    separate: int = 0  # views of a separate session for the intrinsics, taken without the arm; 0: estimated with the rest
    planned: int = 0  # number of views, among all, that `calib plan` chooses after the others


@dataclass(frozen=True)
class Outcome:
    """Errors of one variant, a row per session: (translation [mm], rotation [deg])."""

    variant: Variant
    refined: Array
    park: Array
    stated: Array  # as the calibration states them: root of the sum of the variances
    failures: int

    def medians(self) -> tuple[Array, Array, Array]:
        """(2,) medians of refinement, Park, and stated deviations."""
        return np.median(self.refined, axis=0), np.median(self.park, axis=0), np.median(self.stated, axis=0)


def _with_board(x: int, y: int, square_m: float) -> Rig:
    return replace(KOALA, board=Board.of("charuco", x, y, square_m, 0.73 * square_m, "DICT_5X5_250"))


A3, DENSE = _with_board(12, 9, 0.03), _with_board(18, 13, 0.02)
TILTED = Pattern(tilt_deg=(25.0, 50.0))
FAR = Pattern((25.0, 50.0), (0.3, 0.6))
NEAR = Pattern((20.0, 50.0), (0.25, 0.4), shift_m=0.05)  # as configs/trajectories/calibration.yaml has it
VARIANTS = (
    Variant("board of 9x7 squares of 30 mm, tilts to 35 degrees", KOALA),
    Variant("the same, intrinsics from 60 views of their own", KOALA, separate=60),
    Variant("tilts of 25 to 50 degrees", KOALA, TILTED),
    Variant("distances of 0.3 to 0.6 m", KOALA, Pattern(distance_m=(0.3, 0.6))),
    Variant("no roll about the optical axis", KOALA, Pattern(roll_deg=(-10.0, 10.0))),
    Variant("50 views", KOALA, views=50),
    Variant("board of 12x9 squares of 30 mm (A3)", A3),
    Variant("A3 board, tilts of 25 to 50 degrees", A3, TILTED),
    Variant("A3 board of 18x13 squares of 20 mm", DENSE),
    Variant("A3 board of 18x13 squares of 20 mm, tilts of 25 to 50 degrees, 0.3 to 0.6 m", DENSE, FAR),
    Variant("A3 board, tilts of 25 to 50 degrees, intrinsics from 60 views of their own", A3, TILTED, separate=60),
    Variant("tilts of 20 to 50 degrees at 0.25 to 0.4 m", KOALA, NEAR),
    Variant("10 views of the first kind, then 15 by `calib plan`", KOALA, planned=15),
)


def run(
    sessions: int, seed: int, *, variants: Sequence[Variant] = VARIANTS, done: Callable[[Outcome], None] = lambda outcome: None
) -> Iterator[Outcome]:
    """Errors of `sessions` simulated sessions of each variant."""
    for number, variant in enumerate(variants):
        rows, failures = [], 0
        for session in range(sessions):
            try:
                rows.append(_once(variant, np.random.default_rng([seed, number, session])))
            except CalibrationError:
                failures += 1
        table = np.array(rows, np.float64).reshape(-1, 3, 2)
        outcome = Outcome(variant, table[:, 0], table[:, 1], table[:, 2], failures)
        done(outcome)
        yield outcome


def target_session(simulated: Simulated, name: str = "simulated") -> TargetSession:
    """A simulated session in the form of a detected one."""
    camera = simulated.rig.camera
    seen, flown = tuple(simulated.observations()), simulated.session.base_from_flange
    return TargetSession(simulated.rig.board, camera.width, camera.height, seen, flown, provenance={"frames_sha256": name})


def _once(variant: Variant, rng: np.random.Generator) -> Array:
    """(3, 2) errors of refinement and Park, and what was stated, of one session."""
    flown = _flown(variant, rng)
    simulated = _simulated(variant, rng, flown)
    given = None
    if variant.separate:
        alone = viewpoints(rng, variant.rig, variant.separate, variant.pattern)
        given = calibrate.calibrate_intrinsics(target_session(_simulated(variant, rng, alone), "alone"))
    session = target_session(simulated)
    found = calibrate.calibrate_handeye(session, given, ARM)
    assert found.flange_from_camera is not None  # the camera is on the flange
    camera = given.camera if given else estimate.calibrate(session.observations, session.width, session.height).camera
    park = closed_forms.solve(session.base_from_flange, estimate.camera_from_boards(camera, session.observations), "park")
    truth = simulated.truth.mount_from_camera
    refined = found.flange_from_camera
    return np.array([rms_difference(truth, refined.matrix), rms_difference(truth, park.mount_from_camera), refined.total_std])


def _flown(variant: Variant, rng: np.random.Generator) -> Array:
    """(views, 4, 4) base_from_camera: drawn, and then planned from what these have shown."""
    drawn = viewpoints(rng, variant.rig, variant.views - variant.planned, variant.pattern)
    if not variant.planned:
        return drawn
    solution = calibrate.solve(target_session(_simulated(variant, rng, drawn)), accuracy=ARM)
    return np.concatenate([drawn, next_views.plan(solution, variant.planned).base_from_camera])


def _simulated(variant: Variant, rng: np.random.Generator, base_from_camera: Array) -> Simulated:
    return simulate(rng, variant.rig, base_from_camera, sigma_px=SIGMA_PX, arm=ARM)


def markdown(outcomes: Sequence[Outcome]) -> str:
    """A table with one row per variant."""
    lines = ["| session | refinement, median | Park, median | stated | below both aims |", "|---|---|---|---|---|"]
    for outcome in outcomes:
        if not len(outcome.refined):
            lines.append(f"| {outcome.variant.name} | failed {outcome.failures} times | | | no |")
            continue
        refined, park, stated = outcome.medians()
        below = "yes" if (refined <= AIM).all() else "no"
        lines.append(
            f"| {outcome.variant.name} | {refined[0]:.3f} mm, {refined[1]:.4f}° | {park[0]:.3f} mm, {park[1]:.4f}° "
            f"| {stated[0]:.3f} mm, {stated[1]:.4f}° | {below} |"
        )
    return "\n".join(lines)
