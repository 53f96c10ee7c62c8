"""Sessions of simulated arms that are built off the links that their controller believes in."""

from dataclasses import replace

import numpy as np

from koala3d.calib.advice.patterns import Rig, ViewRange, viewpoints
from koala3d.calib.advice.simulate import ARM, SIGMA_PX, simulate, target_session
from koala3d.calib.arrays import Array
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets import kinematics, pose
from koala3d.datasets.calibration import UncertainPose
from koala3d.datasets.kinematics import UR5E, Links

PATTERN = ViewRange((20.0, 50.0), (0.3, 0.5))
POSTURE = np.array([0.3, -1.8, 1.9, -1.6, -1.5, 0.5])  # near which the arm takes its views [rad]
ATTEMPTS, STEPS, EXACT = 12, 25, 1e-9  # postures that are tried, Newton steps from each, largest distance left [m, rad]


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
