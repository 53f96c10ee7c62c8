"""Whether reflections carry all colour at the start: not of a painted object.

On a surface that begins nearly right, as the masks' hull, a reflection explains paint as well as a diffuse colour does, and keeps
it. A metal needs the reverse: what its diffuse colour takes at the start becomes a painted hollow. How far the views of a place
agree tells them apart.
"""

import numpy as np
from jaxtyping import Bool, Int

from koala3d.reconstruct.config import Config
from koala3d.reconstruct.scene.rays import Pixels
from koala3d.reconstruct.training.decisions.evidence.agreement import agreement
from koala3d.reconstruct.training.decisions.skip import Skip

NAME, WHAT = "dark_start", "reflections that carry all colour at the start"
PAINTED = 0.73
"""Agreement from which on an object counts as painted; docs/skipping.md has it for many scenes."""


def decided(
    pixels: Pixels, possible: Bool[np.ndarray, " cells"] | None, config: Config, session: Int[np.ndarray, " views"] | None = None
) -> Skip:
    """The decision; if it is to skip them, the overlay `painted` holds.

    Args:
        possible: cells of the object's cube that masks leave; None: there are no masks, or colours of places tell nothing.
        session: of each view, where the object was turned over; see `agreement.sessions`.
    """
    if config.field.appearance != "reflection" or not config.overlays.painted:
        return Skip(NAME, WHAT, False, "the model has no reflections, or one start for all")
    agreed = None if possible is None else agreement(pixels, possible, session)
    if agreed is None:
        return Skip(
            NAME, WHAT, False, "without masks, or under lamps that move from view to view, nothing tells paint from metal"
        )
    evidence = f"views of a place agree on {agreed:.0%} of its light; on paint that is {PAINTED:.0%} or more"
    return Skip(NAME, WHAT, agreed >= PAINTED, evidence)
