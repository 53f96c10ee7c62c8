import numpy as np
import pytest

from koala3d.capture.drivers.errors import PlanningError
from koala3d.capture.sessions.adaptive import gain, loop
from koala3d.capture.sessions.adaptive.candidates import seen_from
from koala3d.capture.sessions.adaptive.loop import CandidateViews, CoverageGoal, Why


def run(reach, arm, trajectory, goal):
    shown = []
    outcome = loop.run(reach, arm, goal, trajectory.motion, show=lambda *state: shown.append(state))
    return outcome, shown


def test_a_session_ends_where_the_surface_is_covered(reach, arm, trajectory):
    outcome, shown = run(reach, arm, trajectory, CoverageGoal(until_coverage=0.9))
    assert outcome.reason == loop.COVERED and outcome.coverage.covered >= 0.9
    before = [coverage.covered for _, _, coverage in shown]
    assert before == sorted(before) and before[-2] < 0.9 and [views for views, _, _ in shown] == list(range(1, arm.taken + 1))
    assert all(why.kind == "gain" and why.surface > 0 and why.seconds > 0 for _, why, _ in shown)
    # each view shows what the loop expected of it
    taken = seen_from(np.array(arm.flown), arm.places, None)
    known = gain.coverage(arm.places, taken, reach.seen(arm.known()))
    assert known.covered == pytest.approx(outcome.coverage.covered)


def test_chosen_views_cover_more_than_as_many_spread_ones(reach, arm, trajectory, candidates):
    outcome, _ = run(reach, arm, trajectory, CoverageGoal(views=14))
    assert outcome.reason == loop.ENOUGH_VIEWS and arm.taken == 14
    spread = [one.base_from_camera for one in candidates][:: len(candidates) // 14][:14]
    seen = seen_from(np.array(spread), arm.places, None)
    assert gain.coverage(arm.places, seen, reach.seen(arm.known())).covered < outcome.coverage.covered


def test_a_session_ends_where_nothing_is_gained(reach, arm, trajectory):
    outcome, shown = run(reach, arm, trajectory, CoverageGoal())
    assert outcome.reason == loop.NOTHING and outcome.coverage.covered > 0.97
    arm.changing = 1.0
    outcome, more = run(reach, arm, trajectory, CoverageGoal())
    assert outcome.reason == loop.NOTHING and more, "colours that change are worth more directions"
    assert all(why.angles > why.surface for _, why, _ in more) and not any(why.angles for _, why, _ in shown)


def test_a_session_ends_when_its_time_is_over(reach, arm, trajectory):
    outcome, _ = run(reach, arm, trajectory, CoverageGoal(minutes=0.1))
    assert outcome.reason == loop.TIME and 6 <= arm.seconds < 12


def test_views_without_a_path_are_named(reach, arm, trajectory, monkeypatch):
    take = arm.choose

    def enclosed(joints: np.ndarray, why: Why) -> None:
        """No path leads anywhere after the first view."""
        if arm.taken:
            raise PlanningError("no path around the obstacles was found")
        take(joints, why)

    monkeypatch.setattr(arm, "choose", enclosed)
    outcome, _ = run(reach, arm, trajectory, CoverageGoal())
    assert outcome.reason == loop.NO_PATH and arm.taken == 1


def test_travel_decides_between_equal_views(reach, arm, trajectory, candidates, obstacles):
    """Two candidates that are one: the arm takes neither the long way nor the same view twice for nothing."""
    twice = CandidateViews([candidates[0], candidates[0]], obstacles, reach.eye)
    outcome, shown = run(twice, arm, trajectory, CoverageGoal())
    assert outcome.reason == loop.NOTHING and arm.taken == 3, "a place counts as covered after three views"
    assert shown[1][1].seconds == 0


def test_every_reason_has_words():
    assert set(loop.REASONS) == {loop.COVERED, loop.ENOUGH_VIEWS, loop.TIME, loop.NOTHING, loop.NO_PATH}
    words = {kind: Why(kind, 0.031, 0.002, 1.5).words for kind in ("first", "test", "gain")}
    assert words["gain"] == "unseen surface +3.1 %, new angles +0.2 %, 1.5 s away" and len(set(words.values())) == 3
