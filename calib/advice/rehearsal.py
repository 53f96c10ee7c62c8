"""Rehearsals: the adviser's questions answered for simulated rigs, without pictures. `tests/bench/calibrate.py` asks.

A rig of a seed differs from the drawing as those of the simulator do: the bracket by 3 mm and 1 degree, the lens in every value,
the board by 10 mm and 3 degrees. Corners have 0.1 px of noise, the arm 0.03 mm and 0.005 degrees per axis. The adviser takes the
arm for what `calib handeye` takes it for by default.
"""

from dataclasses import replace

import numpy as np

from koala3d.calib.advice import information
from koala3d.calib.advice.adviser import Adviser, Wanted
from koala3d.calib.advice.information import Knowledge
from koala3d.calib.advice.patterns import Rig
from koala3d.calib.advice.serve import answered
from koala3d.calib.advice.simulate import ARM, KOALA, SIGMA_PX, simulate
from koala3d.calib.arrays import Array
from koala3d.calib.handeye import model
from koala3d.calib.handeye.refine import Sigmas
from koala3d.calib.intrinsics import lenses, projection
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.targets.detection import Observation
from koala3d.datasets import pose
from koala3d.datasets.advice import Answer, Figures, Question
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import UsageError

FOCAL_PX = 1272.7  # a 2.8 mm lens over pixels of 2.2 um


def draw_rig(seed: int) -> Rig:
    """The rig of a seed."""
    rng = np.random.default_rng([seed, 31])
    fx = FOCAL_PX * (1 + rng.normal(0, 0.004))
    centre = np.array([960.0, 540.0]) + rng.normal(0, 10, 2)
    bent = rng.normal([-0.11, 0.06, 0.0, 0.0, -0.012], [0.01, 0.005, 8e-4, 8e-4, 0.0])
    camera = Camera(1920, 1080, fx, fx * (1 + rng.normal(0, 2e-4)), *map(float, centre), *map(float, bent))
    mount = KOALA.flange_from_camera @ pose.from_rotation_vector(np.deg2rad(1) * _direction(rng), 3e-3 * _direction(rng))
    board = KOALA.base_from_board @ pose.from_rotation_vector(np.deg2rad(3) * _direction(rng), 1e-2 * _direction(rng))
    return Rig(camera, KOALA.board, mount, board)


def _direction(rng: np.random.Generator) -> Array:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector), np.float64)


class Rehearsed:
    """Answers about a simulated rig. A question with `rehearse` begins the next one."""

    def __init__(self, until: Figures) -> None:
        self.until = until
        self.rig: Rig | None = None

    def __call__(self, question: Question) -> Answer:
        """The answer, after the views that the question says were flown. Raises UsageError before the first `rehearse`."""
        if question.rehearse is not None:
            self.rig, self.rng = draw_rig(question.rehearse), np.random.default_rng([question.rehearse, 32])
            self.adviser = Adviser(Wanted(self.until, KOALA.flange_from_camera))
            self.seen: list[Observation] = []
            self.flown: list[Array] = []
            self.newest_seen, self.views = False, 0
        if self.rig is None:
            raise UsageError("no rehearsal has begun", remedy="ask with 'rehearse' first")
        for base_from_flange in question.flown:
            self._fly(self.rig, base_from_flange)
        if not self.seen:
            return Answer()
        size = self.rig.camera.width, self.rig.camera.height
        session = TargetSession(self.rig.board, *size, tuple(self.seen), np.stack(self.flown), provenance={})
        answer = replace(answered(self.adviser, session, question), seen=self.newest_seen)
        return replace(answer, truth=self._truth(self.rig), spread=self._spread(self.rig))

    def _fly(self, rig: Rig, base_from_flange: Array) -> None:
        """One view, kept if it shows enough of the board."""
        one = simulate(self.rng, rig, (base_from_flange @ rig.flange_from_camera)[None], sigma_px=SIGMA_PX, arm=ARM)
        seen = information.visible(model.camera_points(one.session, one.truth), one.session.pixels, rig.camera)
        observation = replace(one, session=one.session.some(seen)).observations()[0]
        self.views += 1
        self.newest_seen = len(observation.ids) >= information.MIN_CORNERS
        if self.newest_seen:
            self.seen.append(replace(observation, name=f"{self.views:03d}"))
            self.flown.append(one.session.base_from_flange[0])

    def _truth(self, rig: Rig) -> Figures | None:
        known = self.adviser.known
        if known is None or self.adviser.figures is None:
            return None
        return pose.rms_difference(rig.flange_from_camera, known.state.mount_from_camera)

    def _spread(self, rig: Rig) -> Figures | None:
        """Root mean square errors at the Cramer-Rao bound, with the rig and its noise as they are, for the usual lens."""
        if self.adviser.figures is None:
            return None
        state = replace(self.adviser.known.state, intrinsics=projection.vector(rig.camera)) if self.adviser.known else None
        assert state is not None  # there are figures
        state = replace(state, mount_from_camera=rig.flange_from_camera, stand_from_board=rig.base_from_board)
        sigmas = Sigmas(SIGMA_PX, ARM.translation_m, ARM.rotation_rad)
        size = len(lenses.USUAL.free) + 12
        known = Knowledge(rig.camera, rig.board, lenses.USUAL.free, state, sigmas, np.zeros((size, size)))
        told = [one for one in information.informations(known, np.stack(self.flown)) if one is not None]
        covariance = information.at_the_pose(information.pose_covariance(np.sum(told, axis=0)), state)
        variance = np.diag(covariance)
        return 1e3 * float(np.sqrt(variance[:3].sum())), float(np.rad2deg(np.sqrt(variance[3:].sum())))
