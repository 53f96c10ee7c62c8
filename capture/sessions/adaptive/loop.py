"""The loop: take the view that adds most, until the surface is covered, the time is over, or nothing more is to be gained."""

import itertools
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import PlanningError
from koala3d.capture.model.trajectory import Motion
from koala3d.capture.planning import Obstacles, Pace, move_duration
from koala3d.capture.sessions.adaptive import gain
from koala3d.capture.sessions.adaptive.candidates import ReachableView, see, seen_from
from koala3d.capture.sessions.adaptive.gain import Coverage, Seen
from koala3d.capture.sessions.adaptive.places import Places
from koala3d.capture.sessions.adaptive.sight import Eye
from koala3d.datasets.camera_model import Camera

Array = NDArray[np.float64]

ANGLES = 0.1
"""Worth of a new viewing direction on a place, relative to the worth of a first view of it."""
PRICE = 0.0005
"""What a second of travel at the speed of the trajectory costs, as a share of the surface."""
LEAST = 0.001
"""A view that adds less than this share of the surface adds nothing."""
MOST = 999  # views of a session: their names have three digits
PATHS = 20  # views whose paths are tried before the loop gives up

COVERED, ENOUGH_VIEWS, TIME, NOTHING, NO_PATH = "covered", "views", "time", "nothing", "no path"
REASONS = {
    COVERED: "the wanted share of the surface within reach (--until-coverage) is covered",
    ENOUGH_VIEWS: "the wanted number of views (--views) is taken",
    TIME: "the time (--minutes) is over",
    NOTHING: "nothing more is to be gained: no view within reach shows new surface or a new angle where colours change",
    NO_PATH: "no path leads to a view that adds something",
}


@dataclass(frozen=True)
class CoverageGoal:
    """When the session ends; what is None does not end it."""

    until_coverage: float | None = None
    views: int | None = None
    minutes: float | None = None


@dataclass(frozen=True)
class Why:
    """Why a view was chosen."""

    kind: str
    """"first", "test" or "gain"."""
    surface: float = 0.0
    """What it was expected to add to the surface that is seen [share of the surface]."""
    angles: float = 0.0
    """What it was expected to add to directions where colours change [share of the surface]."""
    seconds: float = 0.0
    """The travel to it."""
    covered: float | None = None
    """Coverage before it, from 0 to 1."""

    @property
    def words(self) -> str:
        """The reason in words."""
        if self.kind != "gain":
            return "first look around the object" if self.kind == "first" else "test view of the trajectory"
        return f"unseen surface +{100 * self.surface:.1f} %, new angles +{100 * self.angles:.1f} %, {self.seconds:.1f} s away"

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary, with the words."""
        return {**asdict(self), "words": self.words}


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of the object after the views so far."""

    places: Places
    changing: Array
    """(n,) how much the colour of each place changes with direction, from 0 to 1."""
    cameras: Array
    """(m, 4, 4) base_from_camera of the training views [m]."""
    camera: Camera | None
    """None: the lens is not known, and pictures are taken to show all of the object."""
    source: str
    """Where the shape comes from, in words."""


class ViewTaker(Protocol):
    """What takes the views: a rig with its recording, or a rehearsal."""

    @property
    def taken(self) -> int:
        """Number of views so far."""
        ...

    @property
    def seconds(self) -> float:
        """Time since the command began."""
        ...

    def joints(self) -> Array:
        """(n,) present joint angles [rad]."""
        ...

    def choose(self, joints: Array, why: Why) -> None:
        """Take one view. Raises PlanningError, before anything moves, where no path leads to it."""

    def known(self) -> Known:
        """What the views so far show."""
        ...


@dataclass(frozen=True)
class CoverageOutcome:
    """Why the loop ended (a key of `REASONS`), and how far the surface is covered."""

    reason: str
    coverage: Coverage
    known: Known


class CandidateViews:
    """The candidates, and how they see the places that are known at the time."""

    def __init__(self, candidates: list[ReachableView], obstacles: Obstacles, eye: Eye) -> None:
        self.candidates, self.obstacles, self.eye = candidates, obstacles, eye
        self._seen: tuple[Places, Seen] | None = None

    def seen(self, known: Known) -> Seen:
        """How the candidates see the places; computed again when these have changed."""
        if self._seen is None or self._seen[0] is not known.places:
            self._seen = known.places, see(self.candidates, known.places, self.obstacles, self.eye, known.camera)
        return self._seen[1]


def run(
    reach: CandidateViews,
    arm: ViewTaker,
    goal: CoverageGoal,
    motion: Motion,
    *,
    show: Callable[[int, Why, Coverage], None] = lambda *_: None,
) -> CoverageOutcome:
    """Take views until the goal is reached or nothing helps. Continues where the views that `arm` has already taken end.

    Args:
        show: called after each view with the number of views, why it was taken, and the coverage after it.
    """
    last: Why | None = None
    while True:
        known = arm.known()
        seen, taken = reach.seen(known), seen_from(known.cameras, known.places, known.camera)
        coverage = gain.coverage(known.places, taken, seen)
        if last is not None:
            show(arm.taken, last, coverage)
        if goal.until_coverage is not None and coverage.covered >= goal.until_coverage:
            return CoverageOutcome(COVERED, coverage, known)
        if arm.taken >= (goal.views or MOST):
            return CoverageOutcome(ENOUGH_VIEWS, coverage, known)
        if goal.minutes is not None and arm.seconds >= 60 * goal.minutes:
            return CoverageOutcome(TIME, coverage, known)
        surface = gain.surface_gains(known.places, taken, seen)
        flown, ahead = (gain.directions(known.places.points, views.eyes) for views in (taken, seen))
        nearest = gain.nearest_directions(flown, taken.well, ahead)
        angles = ANGLES * gain.angle_gains(known.places, known.changing, taken, seen, nearest)
        if (surface + angles).max(initial=0.0) < LEAST:
            return CoverageOutcome(NOTHING, coverage, known)
        last = _take(reach, arm, surface, angles, coverage.covered, motion)
        if last is None:
            return CoverageOutcome(NO_PATH, coverage, known)


def _take(reach: CandidateViews, arm: ViewTaker, surface: Array, angles: Array, covered: float, motion: Motion) -> Why | None:
    """Take the view with the largest gain less its travel; None where no path leads to one that adds something."""
    present = arm.joints()
    ends = [one.solutions.joints[one.nearest(present)] for one in reach.candidates]
    seconds = np.array([move_duration(motion, float(np.abs(end - present).max())) for end in ends])
    order = np.argsort(-(surface + angles - PRICE * seconds), kind="stable")
    useful = (index for index in order if surface[index] + angles[index] >= LEAST)
    for index in itertools.islice(useful, PATHS):
        travel = Pace.of(present, ends[index], motion, reach.obstacles.carrier).seconds
        why = Why("gain", float(surface[index]), float(angles[index]), travel, covered)
        try:
            arm.choose(ends[index], why)
        except PlanningError:
            continue
        return why
    return None
