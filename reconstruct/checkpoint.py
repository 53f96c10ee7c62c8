"""Checkpoints of a training state through orbax: complete or absent, never half-written; the last two are kept.

RUN/checkpoints/STEP    the state's arrays by their paths in it, and numbers beside it such as the seconds trained so far

An array is stored under its path, so that a model can be read without the optimiser's moments.
"""

import logging
import shutil
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np

from reconstruct.errors import ReconstructError

KEPT = 2
SCENE_SIZED = (".visits", ".per_image", ".poses")
"""Ends of the paths of leaves whose length is the scene's, not the configuration's: taken as they were stored."""
MODEL, MOMENTS = ".model", (".optimiser.mu", ".optimiser.nu")
Tree = TypeVar("Tree")


def save(folder: Path, state: Any, clock: dict[str, float]) -> None:
    """Write state and clock under `folder/STEP`, then drop all but the newest.

    Args:
        state: a tree with the number of its step as `step`.
        clock: numbers beside the state, such as the seconds trained so far.
    """
    path = Path(folder).resolve() / f"{int(state.step):08d}"
    if path.exists():
        return
    leaves = {name: np.asarray(leaf) for name, leaf in zip(_names(state), jax.tree.leaves(state), strict=True)}
    _checkpointer().save(path, {"state": leaves, "clock": {name: np.asarray(value) for name, value in clock.items()}})
    for old in steps(folder)[:-KEPT]:
        shutil.rmtree(old)


def steps(folder: Path) -> list[Path]:
    """Complete checkpoints, oldest first."""
    found = Path(folder).glob("[0-9]" * 8)
    return sorted(path for path in found if path.is_dir())


def load(folder: Path, like: Tree) -> tuple[Tree, dict[str, float]]:
    """State and clock of the newest checkpoint, in the structure of `like`.

    Raises:
        ReconstructError: there is none, or it was made with another configuration.
    """
    path, content = _newest(folder)
    stored = _by_name(content["state"], [name.removeprefix(MODEL) for name in _names(like) if name.startswith(MODEL)])
    return _filled(path, like, stored, ""), {name: float(value) for name, value in content["clock"].items()}


def load_model(folder: Path, like: Tree) -> tuple[Tree, int]:
    """Model of the newest checkpoint, in the structure of `like`, and the number of its step. Raises as `load` does."""
    path, content = _newest(folder)
    return _filled(path, like, _by_name(content["state"], _names(like)), MODEL), int(path.name)


def _newest(folder: Path) -> tuple[Path, dict[str, Any]]:
    found = steps(folder)
    if not found:
        raise ReconstructError("holds no checkpoint", where=folder, remedy="train first")
    return found[-1], _checkpointer().restore(found[-1].resolve())


def _names(tree: Any) -> list[str]:
    """Paths of a tree's leaves."""
    return [jax.tree_util.keystr(path) for path, _ in jax.tree.leaves_with_path(tree)]


def _filled(path: Path, like: Tree, stored: dict[str, Any], prefix: str) -> Tree:
    """The stored arrays in the structure of `like`, whose paths follow `prefix`."""
    leaves, structure = jax.tree.flatten(like)
    filled = []
    for name, leaf in zip(_names(like), leaves, strict=True):
        found = stored.get(prefix + name)
        if found is None or (np.shape(found) != np.shape(leaf) and not name.endswith(SCENE_SIZED)):
            raise ReconstructError("checkpoint does not fit the configuration", where=path, remedy="train again")
        filled.append(jax.numpy.asarray(found, leaf.dtype))
    return jax.tree.unflatten(structure, filled)


def _by_name(stored: dict[str, Any], model: list[str]) -> dict[str, Any]:
    """Stored arrays by their paths in a state.

    The first checkpoints numbered them: the model without its grid, the count of steps, both moments (also of the blur), the
    grid, step, skipped.

    Args:
        model: paths of a model's leaves.
    """
    if "0000" not in stored:
        return stored
    learned = [name for name in model if ".grid." not in name]
    grid = [name for name in model if ".grid." in name]
    names = [MODEL + name for name in learned] + [".optimiser.count"]
    names += [moments + name for moments in MOMENTS for name in learned]
    names += [MODEL + name for name in grid] + [".step", ".skipped"]
    arrays = [stored[key] for key in sorted(stored)]
    return dict(zip(names, arrays, strict=True)) if len(names) == len(arrays) else {}


def _checkpointer():
    import orbax.checkpoint as ocp

    logging.getLogger("absl").setLevel(logging.ERROR)
    alone = {jax.process_index()}  # of several processes one writes, and each reads by itself
    options = ocp.options.MultiprocessingOptions(primary_host=jax.process_index(), active_processes=alone)
    return ocp.Checkpointer(ocp.PyTreeCheckpointHandler(multiprocessing_options=options), multiprocessing_options=options)
