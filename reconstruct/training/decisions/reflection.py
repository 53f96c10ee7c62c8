"""Whether a model reflects: not if most of the object keeps its colour from view to view."""

from koala3d.reconstruct.config import Config
from koala3d.reconstruct.training.decisions.skip import Skip

NAME, WHAT = "reflection", "reflections of a matte object"
SAVING = "predicted normals, reflected directions and the regularisers that look at them"
MOSTLY = 0.4
"""Share of the object that keeps its colour, from which on it counts as matte: docs/skipping.md has it for many scenes."""


def in_question(config: Config) -> bool:
    """Whether reflections may be left out."""
    return config.skip.reflection and config.field.appearance == "reflection" and bool(config.overlays.matte)


def decided(matte: float | None, config: Config) -> Skip:
    """The decision; if it is to skip them, the overlay `matte` holds.

    Args:
        matte: share of the object that keeps its colour from view to view; None: not known.
    """
    if not in_question(config):
        evidence = "the model has none" if config.field.appearance != "reflection" else "forced"
        return Skip(NAME, WHAT, False, evidence, SAVING)
    if matte is None:
        return Skip(NAME, WHAT, False, "without masks, or under lamps that move, nothing tells matte from shiny", SAVING)
    return Skip(NAME, WHAT, matte >= MOSTLY, f"{matte:.0%} of the object keeps its colour from view to view", SAVING)
