"""The loop: look for the board, then take the view that tells most, until the wanted accuracy or until nothing helps."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import PlanningError
from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.planning import move_duration
from koala3d.capture.sessions.calibrate import candidates
from koala3d.capture.sessions.calibrate.candidates import BoardView
from koala3d.datasets.advice import Answer, Figures, Question

Array = NDArray[np.float64]

LOOKS = 8  # views that look for the board before the loop gives up
LOST = 4  # views in a row without the board after which it gives up
GOOD = 0.9  # among views with this share of the best one's gain, the nearest is taken
PATHS = 20  # views whose paths are tried before the loop gives up

REACHED, ENOUGH_VIEWS = "reached", "views"
NOT_FOUND, LOST_BOARD, HIDDEN, NO_PATH, USELESS = "not found", "lost", "hidden", "no path", "useless"
REASONS = {
    REACHED: "both errors are small enough",
    ENOUGH_VIEWS: "the largest number of views (--max-views) is taken",
    NOT_FOUND: "the board is in none of the views that look for it",
    LOST_BOARD: f"{LOST} views in a row do not show the board",
    HIDDEN: "no view within reach shows enough of the board",
    NO_PATH: "no path leads to a view that helps",
    USELESS: "no view within reach lowers the errors noticeably",
}


@dataclass(frozen=True)
class AccuracyGoal:
    """When the session is good enough, and when it ends in any case."""

    until: Figures = (0.05, 0.01)
    max_views: int = 80
    least_gain: float = 0.01  # share by which the best view must lower the squares of the errors


class BoardViewTaker(Protocol):
    """What takes the views: a rig with its recording, or a rehearsal."""

    @property
    def taken(self) -> int:
        """Number of views so far."""
        ...

    def joints(self) -> Array:
        """(n,) present joint angles [rad]."""
        ...

    def take(self, joints: Array) -> None:
        """Take one view. Raises PlanningError, before anything moves, where no path leads to it."""

    def ask(self, question: Question) -> Answer:
        """Ask the adviser, who knows every view taken so far."""
        ...


@dataclass(frozen=True)
class CalibrationOutcome:
    """Why the loop ended (a key of `REASONS`), and the adviser's last word."""

    reason: str
    answer: Answer


def size(figures: Figures, until: Figures) -> float:
    """The sum of the squares of both errors, each over the wanted one."""
    return (figures[0] / until[0]) ** 2 + (figures[1] / until[1]) ** 2


def reached(figures: Figures | None, until: Figures) -> bool:
    """Whether both errors are known and small enough."""
    return figures is not None and figures[0] <= until[0] and figures[1] <= until[1]


def run(
    trajectory: Trajectory,
    carrier: Carrier,
    arm: BoardViewTaker,
    goal: AccuracyGoal,
    *,
    seed: int = 0,
    show: Callable[[int, Answer], None],
) -> CalibrationOutcome:
    """Take views until the goal is reached or nothing helps. Continues where the views that `arm` has already taken end.

    Args:
        carrier: the arm with its camera.
        show: called with the number of views and the answer after each view.
    """
    pool, blind = _Pool(trajectory, carrier, seed), 0
    while True:
        answer = arm.ask(Question(candidates=pool.flanges))
        show(arm.taken, answer)
        blind = 0 if answer.seen else blind + 1
        if reached(answer.figures, goal.until):
            answer = arm.ask(Question(anew=True, candidates=pool.flanges))
            if reached(answer.figures, goal.until):
                return CalibrationOutcome(REACHED, answer)
        if arm.taken >= goal.max_views:
            return CalibrationOutcome(ENOUGH_VIEWS, answer)
        if answer.board is None:
            reason = _look(trajectory, carrier, arm)
        elif blind >= LOST:
            reason = LOST_BOARD
        else:
            if pool.outdated(answer):
                pool.draw(answer)
                answer = arm.ask(Question(candidates=pool.flanges))
            reason = _choose(trajectory, pool, arm, answer, goal)
        if reason:
            return CalibrationOutcome(reason, answer)


class _Pool:
    """Candidates, drawn when the board is found and again when its place is known well."""

    def __init__(self, trajectory: Trajectory, carrier: Carrier, seed: int) -> None:
        self.trajectory, self.carrier, self.seed = trajectory, carrier, seed
        self.found: list[BoardView] = []
        self.well = False  # whether a calibration said where the board is
        self.drawn = False

    @property
    def flanges(self) -> Array:
        """(n, 4, 4) base_from_flange."""
        return np.array([one.base_from_flange for one in self.found]).reshape(-1, 4, 4)

    def outdated(self, answer: Answer) -> bool:
        """Whether there is no pool yet, or the board's place is better known than when it was drawn."""
        return not self.drawn or (answer.figures is not None and not self.well)

    def draw(self, answer: Answer) -> None:
        """Draw the candidates anew around the board."""
        assert answer.board is not None  # the loop looks for it first
        # beside the arm the views are meant for a board on the table, see `Carrier.flange_for`
        board = answer.board if self.carrier.beside is None else self.trajectory.base_from_board
        reach = candidates.reach_of(self.trajectory, self.carrier, board)
        self.found = candidates.draw(self.trajectory, reach, board, self.seed)
        self.well, self.drawn = answer.figures is not None, True


def _look(trajectory: Trajectory, carrier: Carrier, arm: BoardViewTaker) -> str:
    """Take the next view that looks for the board; the reason why there is none, or nothing."""
    views = candidates.looking(trajectory, carrier, arm.joints(), LOOKS)
    for joints in views[arm.taken :]:
        try:
            arm.take(joints)
        except PlanningError:
            continue
        return ""
    return NOT_FOUND


def _choose(trajectory: Trajectory, pool: _Pool, arm: BoardViewTaker, answer: Answer, goal: AccuracyGoal) -> str:
    """Take the view that tells most; the reason why there is none, or nothing."""
    sizes = np.array([np.inf if one is None else size(one, goal.until) for one in answer.expected])
    if not np.isfinite(sizes).any():
        return HIDDEN
    known = answer.figures is not None
    now = size(answer.figures, goal.until) if answer.figures is not None else float(sizes[np.isfinite(sizes)].max())
    if known and sizes.min() > (1 - goal.least_gain) * now:
        return USELESS
    present, motion = arm.joints(), trajectory.motion
    ends = [candidates.nearest(one.joints, present) for one in pool.found]
    seconds = np.array([move_duration(motion, float(np.abs(end - present).max())) for end in ends])
    good = sizes <= now - GOOD * (now - sizes.min())
    order = [*sorted(np.flatnonzero(good), key=lambda i: seconds[i]), *sorted(np.flatnonzero(~good), key=lambda i: sizes[i])]
    for index in itertools.islice((i for i in order if np.isfinite(sizes[i])), PATHS):
        try:
            arm.take(ends[index])
        except PlanningError:
            continue
        return ""
    return NO_PATH
