"""Where the lamps stand still: as a person says, else as the scene says, else as the pictures say."""

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.scene import View
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.scene.light import STILL, Frame, LightFrame, Vector, room_of
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from koala3d.reconstruct.scene.turntable import Turning, turning
from koala3d.reconstruct.training.decisions.evidence import explained
from koala3d.reconstruct.training.decisions.skip import Skip

NAME, WHAT = "moving_lamps", "light that moves about the object"
SAVING = "a rotation of each reflected direction, and a network for the light on matte parts"
CLEAR_DB = 0.2
"""A frame in which lamps move must explain colours better than the object's own by so much [dB]: see docs/skipping.md."""
AGREEING, ON_RINGS = 0.1, 0.9
"""Shares of pairs of views, and of views, from which cameras could have stood before a turntable."""

Decision = tuple[LightFrame, Skip]
Stated = tuple[Frame | None, Vector | None]
"""As `reconstruct.scene.light.stated` has it."""


def decided_light(
    views: tuple[View, ...],
    pixels: Pixels,
    normalisation: Normalisation,
    possible: NDArray[np.bool_] | None,
    config: Config,
    stated: Stated = (None, None),
) -> Decision:
    """The frame in which the lamps of a scene stand still, and the evidence.

    Args:
        possible: cells of the object's cube that masks leave; None: there are no masks.
        stated: what the scene itself says. The configuration counts for more, the pictures for less.

    Raises:
        UsageError: a turntable is asked for, but the cameras tell no axis.
    """
    known, known_axis = stated
    wanted, said = (known, "stated by the scene") if config.light.frame == "auto" and known else (config.light.frame, "forced")
    axis = config.light.axis or known_axis
    if config.field.appearance != "reflection":
        return STILL, Skip(NAME, WHAT, True, "the model reflects nothing")
    if wanted == "world":
        return STILL, Skip(NAME, WHAT, True, said, SAVING)
    turned = turning(np.stack([view.world_from_camera[:3, :3] for view in views]))
    if wanted != "auto":
        return _frame(wanted, turned, views, normalisation, axis), Skip(NAME, WHAT, False, f"{said}: {wanted}", SAVING)
    if not normalisation.bounded or possible is None:
        return STILL, Skip(NAME, WHAT, True, "without masks lamps are taken to stand still", SAVING)
    kinds: list[Frame] = ["camera"]
    if axis or (turned is not None and turned.agreeing >= AGREEING and turned.on_rings >= ON_RINGS):
        kinds.append("turntable")
    frames = [_frame(kind, turned, views, normalisation, axis) for kind in kinds]
    return _explained_best(frames, explained.errors(views, pixels, possible, [STILL, *frames]))


def _explained_best(frames: list[LightFrame], errors: list[float] | None) -> Decision:
    """One of the frames where it is clearly better than `STILL`, whose error comes first."""
    if errors is None:
        return STILL, Skip(NAME, WHAT, True, "too few views or pixels to tell", SAVING)
    gains = [float(10 * np.log10(errors[0] / error)) for error in errors[1:]]
    best = int(np.argmax(gains))
    listed = ", ".join(f"{frame.kind} {gain:+.2f} dB" for frame, gain in zip(frames, gains, strict=True))
    evidence = f"colours in views left out, explained by lamps that move, against lamps that stand still: {listed}"
    if gains[best] < CLEAR_DB:
        return STILL, Skip(NAME, WHAT, True, evidence, SAVING)
    return frames[best], Skip(NAME, WHAT, False, evidence, SAVING)


def _frame(
    kind: Frame, turned: Turning | None, views: tuple[View, ...], normalisation: Normalisation, given: Vector | None
) -> LightFrame:
    axis = given or (None if turned is None else turned.axis)
    if kind in ("camera", "room"):
        axis = (0.0, 0.0, 1.0)
    if axis is None or not np.linalg.norm(axis):
        why, remedy = "no two views differ by a rotation", "give the axis as light.axis"
        raise UsageError("a turntable's axis is not known", where="light.frame=turntable", why=why, remedy=remedy)
    x, y, z = (np.asarray(axis) / np.linalg.norm(axis)).tolist()
    positions = np.stack([view.world_from_camera[:3, 3] for view in views]) - normalisation.centre
    distance = float(np.median(np.linalg.norm(positions, axis=-1)) * normalisation.scale)
    return LightFrame(kind, (x, y, z), distance, room_of(views) if kind == "room" else ())
