"""Objects of one series: a training begins with the weights that another one has learned on the first piece.

Weights mean something only where the object lies in the same place of the normalised scene, so boxes must agree. Everything that
belongs to the pictures begins anew: poses and gains of views, the occupancy grid, the optimiser, the steps.
"""

from dataclasses import replace

import equinox as eqx
import numpy as np

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.scene import Scene
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.run import CHECKPOINTS, Run
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.poses import session_of
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.training.decisions.decide import normalisation_of
from koala3d.reconstruct.training.decisions.poses import corrects_motion
from koala3d.reconstruct.training.step import TrainState

WEIGHTS = "weights_from"
"""Entry of run.json: the run whose weights it began with, their step, and its scene."""
SAME_BOX = 0.01
"""Boxes count as one where their middles are nearer than this share of their size, and their sizes differ by less."""
MODEL, PRESET = "surfnerf", "fast"  # what the command takes where nothing is said


def require_model(run: Run, model: str, preset: str) -> None:
    """Raise UsageError where a model or preset is asked for that is not the run's."""
    for what, asked, usual, found in (
        ("model", model, MODEL, run.config.model),
        ("preset", preset, PRESET, run.config.preset),
    ):
        if asked not in (usual, found):
            remedy = f"leave --{what} out: the configuration is the run's"
            raise UsageError(f"was trained with another {what}", where=run.path, why=f"{found}, not {asked}", remedy=remedy)


def facts_of_series(scene: Scene, run: Run) -> SceneFacts:
    """What is known of a scene that lies as the one of a run: the run's facts, with how near and far this scene is seen.

    Raises UsageError: its box is another one, or only one of them has surroundings.
    """
    known, found = run.facts.normalisation, normalisation_of(scene, run.config)
    remedy = "record both pieces in one place with one trajectory, or train without --from"
    if known.bounded != found.bounded:
        why = "only the scene has surroundings" if known.bounded else "only the run's scene has surroundings"
        raise UsageError("scene does not lie as the run's", where=scene.name, why=why, remedy=remedy)
    moved = float(np.linalg.norm(np.subtract(found.centre, known.centre))) * known.scale
    if max(moved, abs(known.scale / found.scale - 1)) > SAME_BOX:
        why = f"its box has the middle {_words(found)}, the run's {_words(known)}"
        raise UsageError("scene does not lie as the run's", where=scene.name, why=why, remedy=remedy)
    normalisation = replace(known, near=found.near, far=found.far)
    session = session_of(scene, normalisation) if corrects_motion("auto", scene) else None
    return replace(run.facts, normalisation=normalisation, log_gains=None, session=session)


def _words(normalisation: Normalisation) -> str:
    middle = ", ".join(f"{value:.3f}" for value in normalisation.centre)
    return f"{middle} and the half size {1 / normalisation.scale:.3f}"


def with_weights(fresh: TrainState, run: Run) -> tuple[TrainState, int]:
    """A state before its first step with the newest weights of a run, and the step that these are of.

    Raises ReconstructError: the run was trained with other sizes, or has no checkpoint.
    """
    try:
        model, step = checkpoint.load_model(run.path / CHECKPOINTS, fresh.model, other_scene=True)
    except ReconstructError as error:
        if "does not fit" not in error.what:
            raise
        remedy = "leave out the --set values that change sizes, or train without --from"
        raise ReconstructError("its weights do not fit the configuration", where=run.path, why=error.why, remedy=remedy) from None
    learned, rest = model.split()[0], fresh.model.split()[1]
    begun = eqx.combine(learned, rest)
    if model.field.outline is not None:  # the weights say how the shape differs from it
        begun = eqx.tree_at(lambda m: m.field.outline, begun, model.field.outline)
    return eqx.tree_at(lambda state: state.model, fresh, begun), step
