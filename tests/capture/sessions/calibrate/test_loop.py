import numpy as np
import pytest

from koala3d.capture.drivers.errors import PlanningError
from koala3d.capture.model.shapes.geometry import Box
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.planning import Obstacles
from koala3d.capture.sessions.calibrate import candidates, loop
from koala3d.capture.sessions.calibrate.adviser import Adviser, AdviserError
from koala3d.capture.sessions.calibrate.loop import AccuracyGoal
from koala3d.datasets import pose
from koala3d.datasets.advice import Question
from tests.bench.rehearsals import RehearsedArm

NEVER = (1e-4, 1e-5)


def run(trajectory, carrier, arm, goal):
    shown = []
    outcome = loop.run(trajectory, carrier, arm, goal, show=lambda views, answer: shown.append((views, answer)))
    return outcome, shown


def test_a_session_ends_where_both_errors_are_small_enough(trajectory, carrier, arm):
    goal = AccuracyGoal((0.2, 0.05))
    outcome, shown = run(trajectory, carrier, arm, goal)
    assert outcome.reason == loop.REACHED and loop.reached(outcome.answer.figures, goal.until)
    figures = [answer.figures for _, answer in shown if answer.figures]
    assert len(figures) >= 2 and not loop.reached(figures[0], goal.until)  # the premise: it was not reached at once
    assert figures[-1][0] < figures[0][0] and figures[-1][1] < figures[0][1]
    assert [views for views, _ in shown] == list(range(arm.taken + 1))
    truth = outcome.answer.truth
    assert truth is not None and truth[0] < goal.until[0] and truth[1] < goal.until[1]


def test_a_session_ends_at_the_largest_number_of_views(trajectory, carrier, arm):
    outcome, _ = run(trajectory, carrier, arm, AccuracyGoal(NEVER, max_views=6))
    assert outcome.reason == loop.ENOUGH_VIEWS and arm.taken == 6


def test_a_session_ends_where_no_view_helps(trajectory, carrier, arm):
    outcome, _ = run(trajectory, carrier, arm, AccuracyGoal(NEVER, least_gain=0.9))
    assert outcome.reason == loop.USELESS and outcome.answer.figures is not None and arm.taken < 10


def test_a_board_that_is_elsewhere_is_looked_for_and_not_found(carrier, arm):
    aside = load_trajectory("calibration", overrides=["views.0.target=[-0.4, 0.0, 0.0]", "views.0.tilt_deg=[0, 10]"])
    outcome, shown = run(aside, carrier, arm, AccuracyGoal())
    assert outcome.reason == loop.NOT_FOUND and 1 <= arm.taken <= loop.LOOKS
    assert not any(answer.seen for _, answer in shown)


class Covered(RehearsedArm):
    """Somebody covers the board after three views."""

    def take(self, joints: np.ndarray) -> None:
        super().take(joints)
        if self.taken > 3:
            self.flown[-1] = self.flown[-1] @ pose.from_rotation_vector([np.pi, 0, 0])


def test_a_board_that_is_covered_is_missed(trajectory, carrier, arm):
    outcome, _ = run(trajectory, carrier, Covered(trajectory, arm.adviser, arm.obstacles), AccuracyGoal())
    assert outcome.reason == loop.LOST_BOARD and outcome.answer.views == 3


def test_no_room_around_the_first_view_is_named(trajectory, carrier, arm):
    arm.present = candidates.looking(trajectory, carrier, arm.joints(), loop.LOOKS)[0]
    camera = carrier.base_from_camera(arm.present)[:3, 3]
    room = Box(centre=tuple(camera), size=(0.042, 0.042, 0.042))  # twice the clearance, and a millimetre to each side
    narrow = trajectory.model_copy(update={"safety": trajectory.safety.model_copy(update={"workspace": room})})
    arm.obstacles = Obstacles.of(narrow, carrier)
    outcome, _ = run(narrow, carrier, arm, AccuracyGoal())
    assert outcome.reason == loop.HIDDEN and arm.taken == 1


class Enclosed(RehearsedArm):
    """No path leads anywhere after the first view."""

    def take(self, joints: np.ndarray) -> None:
        if self.taken:
            raise PlanningError("no path around the obstacles was found")
        super().take(joints)


def test_views_without_a_path_are_named(trajectory, carrier, arm):
    outcome, _ = run(trajectory, carrier, Enclosed(trajectory, arm.adviser, arm.obstacles), AccuracyGoal())
    assert outcome.reason == loop.NO_PATH


def test_every_reason_has_words():
    reasons = {loop.REACHED, loop.ENOUGH_VIEWS, loop.NOT_FOUND, loop.LOST_BOARD, loop.HIDDEN, loop.NO_PATH, loop.USELESS}
    assert set(loop.REASONS) == reasons


def test_an_adviser_that_has_ended_says_why():
    with Adviser("nowhere", ["--lens", "none"]) as adviser, pytest.raises(AdviserError, match="no lens called 'none'"):
        adviser.ask(Question())


def test_flights_take_as_long_as_planned_ones(trajectory, carrier, arm):
    from koala3d.capture.planning import duration, plan

    planned = plan(trajectory, carrier)[:4]
    arm.present = planned[0].joints
    for view in planned:
        arm.take(view.joints)
    # the planner's estimate, and the settling of the first view's empty path is counted in both
    assert arm.seconds == pytest.approx(duration(trajectory, planned, carrier), rel=1e-6) and arm.taken == 4
