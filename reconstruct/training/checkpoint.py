"""Checkpoints of a training state through orbax: complete or absent, never half-written; the last two are kept."""

import logging
import shutil
from pathlib import Path

import jax
import numpy as np

from reconstruct.errors import ReconstructError
from reconstruct.training.step import TrainState

KEPT = 2
SCENE_SIZED = (".visits", ".per_image", ".poses")
"""Ends of the paths of leaves whose length is the scene's, not the configuration's: taken as they were stored."""


def save(folder: Path, state: TrainState, clock: dict[str, float]) -> None:
    """Write state and clock under `folder/STEP`, then drop all but the newest.

    Args:
        clock: numbers beside the state, such as the seconds trained so far.
    """
    path = Path(folder).resolve() / f"{int(state.step):08d}"
    if path.exists():
        return
    leaves = {f"{i:04d}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(state))}
    _checkpointer().save(path, {"state": leaves, "clock": {name: np.asarray(value) for name, value in clock.items()}})
    for old in steps(folder)[:-KEPT]:
        shutil.rmtree(old)


def steps(folder: Path) -> list[Path]:
    """Complete checkpoints, oldest first."""
    found = Path(folder).glob("[0-9]" * 8)
    return sorted(path for path in found if path.is_dir())


def load(folder: Path, like: TrainState) -> tuple[TrainState, dict[str, float]]:
    """The newest checkpoint, in the structure of `like`.

    Raises:
        ReconstructError: there is none, or it was made with another configuration.
    """
    found = steps(folder)
    if not found:
        raise ReconstructError("holds no checkpoint", where=folder, remedy="train first")
    content = _checkpointer().restore(found[-1].resolve())
    leaves, structure = jax.tree.flatten_with_path(like)
    stored = [content["state"][key] for key in sorted(content["state"])]
    fits = len(stored) == len(leaves) and all(
        np.shape(a) == np.shape(b) or jax.tree_util.keystr(path).endswith(SCENE_SIZED)
        for a, (path, b) in zip(stored, leaves, strict=True)
    )
    if not fits:
        raise ReconstructError("checkpoint does not fit the configuration", where=found[-1], remedy="train again")
    restored = [jax.numpy.asarray(a, b.dtype) for a, (_, b) in zip(stored, leaves, strict=True)]
    return jax.tree.unflatten(structure, restored), {name: float(value) for name, value in content["clock"].items()}


def _checkpointer():
    import orbax.checkpoint as ocp

    logging.getLogger("absl").setLevel(logging.ERROR)
    alone = {jax.process_index()}  # of several processes one writes, and each reads by itself
    options = ocp.options.MultiprocessingOptions(primary_host=jax.process_index(), active_processes=alone)
    return ocp.Checkpointer(ocp.PyTreeCheckpointHandler(multiprocessing_options=options), multiprocessing_options=options)
