"""The adviser: it takes view after view, estimates the rig, and says how much each possible next view would help."""

from dataclasses import dataclass, replace

import numpy as np

from koala3d.calib import calibrate
from koala3d.calib.advice import information, rough
from koala3d.calib.advice.information import Knowledge
from koala3d.calib.arrays import Array
from koala3d.calib.errors import CalibrationError, TargetError, Unobservable
from koala3d.calib.handeye import outliers, uncertainty
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.intrinsics import lenses, projection
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.targets import screening
from koala3d.datasets.advice import Figures
from koala3d.datasets.calibration import Calibration

PATIENCE = 10  # views after which a calibration that is refused is no longer put down to too few views
RENEW = 2.0  # the calibration starts anew, lens included, when there are this many times the views of the last time
LENS_VIEWS = 15  # views from which on a fisheye is among the lenses tried by "auto": with fewer, chance prefers it now and then


@dataclass(frozen=True)
class Wanted:
    """What the session is for, and what is known beforehand."""

    until: Figures  # figures to reach: translation [mm], rotation [deg]
    mount: Array  # (4, 4) flange_from_camera as known from a drawing; base_from_camera of a camera beside the arm
    accuracy: Accuracy = calibrate.STATED
    given: Calibration | None = None  # intrinsics of another session
    lens: str = "auto"


@dataclass
class Adviser:
    """What the views so far have shown. `update` takes more of them; the other methods answer questions."""

    wanted: Wanted
    known: Knowledge | None = None  # None before the first view with the board
    figures: Figures | None = None  # limits of both errors; None while the views do not allow a calibration
    refused: str = ""  # why there is no calibration yet
    solution: calibrate.Solution | None = None  # of all views so far, if they allow one
    _solved: int = 0  # views of the last calibration from the start

    def update(self, session: TargetSession, *, anew: bool = False) -> None:
        """Estimate the rig from all views so far, from the start if `anew`.

        Raises CalibrationError: enough views are there, and they do not fit together.
        """
        views, wanted = len(session.observations), self.wanted
        try:
            if self.solution is None or views >= RENEW * self._solved or (anew and views > self._solved):
                lens = "brown" if wanted.lens == "auto" and views < LENS_VIEWS else wanted.lens
                self.solution = calibrate.solve(session, wanted.given, wanted.accuracy, lens)
                self._solved = views
            self._refine(session, self.solution)
        except CalibrationError as error:
            if views >= PATIENCE and not isinstance(error, TargetError | Unobservable):
                raise
            self.solution, self.figures, self.refused = None, None, str(error)
            self.known = rough.known(session, wanted.mount, wanted.accuracy)

    def _refine(self, session: TargetSession, solution: calibrate.Solution) -> None:
        """The refinement of all views, from the last solution.

        The coefficients of the usual lens are always among the unknowns: with fewer, the figures could be too small.
        """
        first, before, gross = solution.first, solution.fit.refined, set(solution.left_out)
        agreeing, left_out = screening.agreeing_with_plane(session.observations)
        session = session.with_observations([o for o in agreeing if o.name not in gross])
        free = first.free
        if first.known is None and not first.camera.fisheye:
            free = tuple(name for name in projection.NAMES if name in {*free, *lenses.USUAL.free})
        start = replace(before.state, corrections=np.zeros((len(session.observations), 6)))
        options = {"sigma_px": before.sigmas.pixel, "form": projection.form(first.camera)}
        fit = outliers.refine_without(session, start, free, first.known, self.wanted.accuracy, **options)
        refined = fit.refined
        uncertainty.covariance(fit.measured, refined)  # refuses what a calibration would refuse
        camera = projection.with_vector(first.camera, refined.state.intrinsics)
        found = (refined.state, refined.sigmas, refined.information, session.eye_to_hand)
        self.known = Knowledge(camera, session.board, free, *found)
        self.figures, self.refused = information.figures(refined.information, refined.state), ""
        self.solution = replace(solution, first=replace(first, free=free, left_out={**left_out, **first.left_out}), fit=fit)

    def expected(self, base_from_flange: Array) -> list[Figures | None]:
        """Both figures after one more view from each of (n, 4, 4) flange poses; None where it would not show the board."""
        if self.known is None:
            return [None] * len(base_from_flange)
        total, state = self.known.information, self.known.state
        return [
            None if told is None else information.figures(total + told, state)
            for told in information.informations(self.known, base_from_flange)
        ]

    def calibration(self) -> Calibration:
        """The calibration of all views so far. Raises Unobservable where they do not allow one."""
        if self.solution is None:
            raise Unobservable("there is no calibration yet", why=self.refused, remedy="record more views")
        return calibrate.finished(self.solution, self.wanted.accuracy, self.wanted.given is not None)
