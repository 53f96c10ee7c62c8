"""Sessions that choose their views against the fixed ones, on simulated rigs: pure geometry, the real planner, no pictures."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import Trajectory, load_trajectory
from koala3d.capture.planning import Obstacles, Pace, connect, plan
from koala3d.capture.planning.durations import READOUT_S
from koala3d.capture.sessions.calibrate import loop
from koala3d.capture.sessions.calibrate.adviser import Adviser
from koala3d.capture.sessions.calibrate.loop import AccuracyGoal
from koala3d.datasets.advice import Answer, Figures, Question

Array = NDArray[np.float64]

FIXED = "calibration"
"""The shipped trajectory of 25 views: what is compared with, and where the camera may be."""
MAX_VIEWS = 60
START = np.radians([0.0, -90.0, 90.0, -90.0, -90.0, 0.0])  # where the arm of a rehearsal starts


@dataclass(frozen=True)
class Step:
    """A session after one more view."""

    views: int
    seconds: float  # of motion, settling and exposure so far
    figures: Figures | None  # stated limits, 95 %
    truth: Figures | None  # true errors
    spread: Figures | None  # root mean square errors of an efficient estimator with these views


@dataclass(frozen=True)
class Rehearsal:
    """Both sessions of one rig."""

    rig: int
    fixed: list[Step]
    adaptive: list[Step]
    reason: str  # why the adaptive one ended
    stopped: int | None  # views at which the wanted errors were reached


@dataclass
class RehearsedArm:
    """An arm that flies for the adviser's rehearsal; implements `capture.sessions.calibrate.loop.BoardViewTaker`."""

    trajectory: Trajectory
    adviser: Adviser
    obstacles: Obstacles
    present: Array = field(default_factory=lambda: START.copy())
    flown: list[Array] = field(default_factory=list)  # since the last question
    seconds: float = 0.0
    taken: int = 0

    def joints(self) -> Array:
        """(n,) present joint angles [rad]."""
        return self.present

    def take(self, joints: Array) -> None:
        """Fly to one view. Raises PlanningError where no path leads to it."""
        motion = self.trajectory.motion
        for corner in connect(self.present, joints, self.obstacles):
            self.seconds += Pace.of(self.present, corner, motion, self.obstacles.carrier).seconds + motion.settle_time_s
            self.present = corner
        self.seconds += self.trajectory.camera.exposure_us * 1e-6 + READOUT_S
        self.flown.append(self.obstacles.carrier.arm.forward(joints))
        self.taken += 1

    def ask(self, question: Question) -> Answer:
        """Ask with the views flown since the last question."""
        flown, self.flown = self.flown, []
        return self.adviser.ask(Question(question.candidates, question.anew, question.finish, np.array(flown)))


def run(rigs: int, workers: int, until: Figures) -> list[Rehearsal]:
    """Rehearse both kinds of session on `rigs` simulated rigs, `workers` at a time. The wanted errors are those of `until`."""
    trajectory = load_trajectory(FIXED)
    carrier = RigDescription().carrier()
    fixed = [view.joints for view in plan(trajectory, carrier)]

    def several(first: int) -> list[Rehearsal]:
        found = []
        with Adviser("rehearsal", ["--rehearse", "--until", *map(str, until)]) as adviser:
            for rig in range(first, rigs, workers):
                found.append(_one(rig, trajectory, carrier, fixed, adviser, until))
        return found

    with ThreadPoolExecutor(workers) as pool:
        parts = list(pool.map(several, range(workers)))
    return sorted((one for part in parts for one in part), key=lambda one: one.rig)


def _one(rig: int, trajectory: Trajectory, carrier: Carrier, fixed: list[Array], adviser: Adviser, until: Figures) -> Rehearsal:
    obstacles = Obstacles.of(trajectory, carrier)
    adviser.ask(Question(rehearse=rig))
    arm, before = RehearsedArm(trajectory, adviser, obstacles), []
    for number, joints in enumerate(fixed, 1):
        arm.take(joints)
        if number % 5 == 0 and number > 5:
            before.append(_step(arm, arm.ask(Question())))
    adviser.ask(Question(rehearse=rig))
    steps: list[Step] = []
    arm = RehearsedArm(trajectory, adviser, obstacles)
    goal = AccuracyGoal(until, MAX_VIEWS)

    def show(views: int, answer: Answer) -> None:
        if views:
            steps.append(_step(arm, answer))

    outcome = loop.run(trajectory, carrier, arm, goal, seed=rig, show=show)
    steps.append(_step(arm, outcome.answer))
    stopped = arm.taken if outcome.reason == loop.REACHED else None
    return Rehearsal(rig, before, steps, outcome.reason, stopped)


def _step(arm: RehearsedArm, answer: Answer) -> Step:
    return Step(arm.taken, arm.seconds, answer.figures, answer.truth, answer.spread)
