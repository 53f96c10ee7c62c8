"""How an object was moved between two sessions: found by its outlines, with the deviation of what is found, or refused."""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from koala3d.datasets import pose
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.progress import Step, ignore
from koala3d.datasets.scene import Scene
from koala3d.datasets.turned.outlines import Outlines, outlines_of
from koala3d.datasets.turned.search import STARTS, found, turned_by
from koala3d.datasets.turned.tangency import Fit, Pairs

Array = NDArray[np.float64]
SAME_TURN, SAME_SHIFT = np.deg2rad(5.0), 0.1
"""An object lies as before where it was turned by less, and its middle moved by less of its radius."""
FITS = 3.0
"""Misfit of outlines that belong to one object, at most [px]: masks that err by 1.5 px have half of it."""
RIVAL, FLOOR = 1.5, 0.5
"""Another motion that fits not even so many times worse cannot be told from the best; below this misfit [px] they are equal."""
NEARBY = np.deg2rad(25.0)
"""Turns about each axis from which the search also starts, if a person says roughly how the object was moved."""
LOOSE = np.deg2rad(1.0)
"""Deviation of a turn from which it counts as not found."""
ELSEWHERE = 0.5
"""A motion belongs to other scenes if it takes the object's middle so far past where it is, in radii of the object."""
SHAPES = {"a_from_b": (4, 4), "middle": (3,), "covariance": (6, 6)}
"""Of the arrays that a scene states of a registration."""


@dataclass(frozen=True, eq=False)
class Registration:
    """The motion between the worlds of two sessions."""

    a_from_b: Array
    """(4, 4) takes what session b calls a place of the object to what session a calls it."""
    middle: Array
    """(3,) of the object, in a."""
    covariance: Array
    """(6, 6) of the error: shift of the middle [world unit^2] first, then turn about it [rad^2], along the axes of a.

    Masks are taken to err independently of one another: what the calibration has wrong for all views alike is not in it."""
    misfit: float
    """How far the outlines disagree [px of the masks as they were read]; root mean square."""

    @property
    def deviations(self) -> tuple[float, float]:
        """Standard deviations over all axes: shift of the middle [world unit], and turn [rad]."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3]))), float(np.sqrt(np.trace(self.covariance[3:, 3:])))

    def error(self, a_from_b: Array) -> Array:
        """(6,) by how much this motion differs from another one, the true one, as `covariance` has it."""
        back = self.a_from_b @ pose.inverse(a_from_b)
        shift = back[:3, :3] @ self.middle + back[:3, 3] - self.middle
        return np.concatenate([shift, Rotation.from_matrix(back[:3, :3]).as_rotvec()])

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> Self:
        """Inverse of `to_json`; what else is in `content` is not looked at. Raises KeyError or ValueError where it is no such."""
        arrays = (np.array(content[name], np.float64).reshape(shape) for name, shape in SHAPES.items())
        return cls(*arrays, float(content["misfit_px"]))

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary."""
        return {**{name: getattr(self, name).tolist() for name in SHAPES}, "misfit_px": self.misfit}


def require_sessions(a: Scene, b: Scene) -> None:
    """Raise UsageError unless these can be two sessions of one object that was turned over in between."""
    both = f"{a.name}, {b.name}"
    poses = [scene.provenance.get("pose") for scene in (a, b)]
    if poses[0] is not None and poses[0] == poses[1]:
        remedy = "record the second session with 'capture run --pose under'; views of one pose are merged without --turned"
        raise UsageError("both sessions are of the same pose", where=both, why=f"'{poses[0]}'", remedy=remedy)
    sums = [scene.provenance.get("calibration_sha256") for scene in (a, b)]
    if None not in sums and sums[0] != sums[1]:
        remedy = "build both scenes with one calibration"
        raise UsageError("scenes have different calibrations", where=both, remedy=remedy)
    if a.metric != b.metric:
        metric = a.name if a.metric else b.name
        raise UsageError("scenes differ in unit", where=both, why=f"only {metric} is in metres", remedy="see 'datasets edit'")


def registered(a: Scene, b: Scene, start: Array | None = None, *, done: Step = ignore) -> Registration:
    """How the object was moved from session b to session a.

    Args:
        start: roughly how, as a person says: a (3, 3) rotation or a (4, 4) motion; None: it is looked for.
        done: called after each start of the search, see `starts_of`.

    Raises UsageError: the sessions do not fit together, masks are missing, no motion fits, or several fit equally well.
    """
    require_sessions(a, b)
    of_a, of_b = outlines_of(a), outlines_of(b)
    pairs, fits = found(of_a, of_b, starts_of(start), done=done)
    best, both = fits[0], f"{a.name}, {b.name}"
    if not best.misfit <= FITS:
        why = (
            f"in the best pose they miss one another by {best.misfit:.1f} px" if np.isfinite(best.misfit) else "too few are seen"
        )
        remedy = "look whether both scenes show the same object, and at their masks ('datasets mask --page')"
        raise UsageError("outlines of the two scenes fit in no pose", where=both, why=why, remedy=remedy)
    rivals = [fit for fit in fits[1:] if fit.misfit < RIVAL * max(best.misfit, FLOOR)]
    covariance = None if rivals else pairs.covariance(best)
    if covariance is None or np.sqrt(np.trace(covariance[3:, 3:])) > LOOSE:
        raise UsageError("how the object was turned cannot be told", where=both, why=_ambiguity(best, rivals), remedy=_ADVICE)
    _require_moved(best.a_from_b, of_a, of_b, both)
    return Registration(best.a_from_b, of_a.middle, covariance, best.misfit)


def placed(a: Scene, b: Scene, known: Registration) -> Registration:
    """A motion that was found by other means, such as the surfaces of both sessions, with the misfit of the outlines under it.

    Raises UsageError: the sessions do not fit together, masks are missing, or the motion is not of these two scenes.
    """
    require_sessions(a, b)
    of_a, of_b, both = outlines_of(a), outlines_of(b), f"{a.name}, {b.name}"
    a_from_b, turn = known.a_from_b, known.deviations[1]
    apart = float(np.linalg.norm(a_from_b[:3, :3] @ of_b.middle + a_from_b[:3, 3] - of_a.middle)) / of_a.extent
    if apart > ELSEWHERE:
        why = f"it takes the object {apart:.1f} of its radii away from where the masks of {a.name} show it"
        remedy = "it must lead from the second scene to the first; look at their order"
        raise UsageError("the motion is not of these scenes", where=both, why=why, remedy=remedy)
    if turn > LOOSE:
        why = f"the turn is known to {np.rad2deg(turn):.2g} degrees"
        raise UsageError("how the object was turned cannot be told", where=both, why=why, remedy=_ADVICE)
    _require_moved(a_from_b, of_a, of_b, both)
    misfit = Pairs(of_a, of_b).misfit(a_from_b)
    if not np.isfinite(misfit):
        remedy = "record more views from the side"
        raise UsageError("too few outlines of the two scenes can be compared", where=both, remedy=remedy)
    return replace(known, misfit=misfit)


_ADVICE = "choose one with --points or --rough, or fix something to the object that shows at its outline"


def starts_of(start: Array | None) -> list[Array]:
    """Where the search begins: everywhere, or near what a person says."""
    if start is None:
        return list(pose.rotations(STARTS))
    turns = np.concatenate([np.zeros((1, 3)), NEARBY * np.eye(3), -NEARBY * np.eye(3)])
    starts = [Rotation.from_rotvec(turn).as_matrix() @ start[:3, :3] for turn in turns]
    return [start if not number else one for number, one in enumerate(starts)]


def _ambiguity(best: Fit, rivals: list[Fit]) -> str:
    if not rivals:
        return "its outlines hardly change as it turns about an axis"
    turns = sorted(np.rad2deg([turned_by(fit, best) for fit in rivals]))
    angles = ", ".join(f"{turn:.0f}" for turn in turns[:4]) + (" ..." if len(turns) > 4 else "")
    return f"its outlines look the same in {len(rivals) + 1} poses or more, turned against one another by {angles} degrees"


def _require_moved(a_from_b: Array, a: Outlines, b: Outlines, both: str) -> None:
    """Raise UsageError where the object lies as it did: then these are two recordings of one pose."""
    turn = float(pose.rotation_angle(a_from_b))
    shift = float(np.linalg.norm(a.middle - b.middle))
    if turn < SAME_TURN and shift < SAME_SHIFT * a.extent:
        why = f"it was turned by {np.rad2deg(turn):.1f} degrees"
        raise UsageError("object lies in both scenes as it did", where=both, why=why, remedy="merge them without --turned")
