"""Checkpoints of a training state through orbax: complete or absent, never half-written; the last two are kept.

RUN/checkpoints/STEP                   the state's arrays by their paths in it, and numbers such as the seconds trained so far
RUN/checkpoints/STEP/checksums.json    SHA-256 of every other file; a checkpoint that does not match is passed over

An array is stored under its path, so that a model can be read without the optimiser's moments.
"""

import errno
import logging
import shutil
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np

from koala3d.datasets.core import files
from koala3d.datasets.core.console import hint
from koala3d.datasets.core.errors import KoalaError
from koala3d.reconstruct.errors import ReconstructError

KEPT = 2
CHECKSUMS = "checksums.json"
SCENE_SIZED = (".visits", ".per_image", ".poses", ".spread", ".by")
"""Ends of the paths of leaves whose length is the scene's, not the configuration's: taken as they were stored."""
MEASURED = ".bounds.", ".start."
"""In the paths of leaves that were measured on the scene: they are as run.json has them, whatever was stored."""
MODEL = ".model"
Tree = TypeVar("Tree")


def save(folder: Path, state: Any, clock: dict[str, float]) -> None:
    """Write state and clock under `folder/STEP`, then drop all but the newest. On the disk when this returns.

    Args:
        state: a tree with the number of its step as `step`.
        clock: numbers beside the state, such as the seconds trained so far.

    Raises:
        ReconstructError: it cannot be written, for example because the disk is full. The checkpoints before are still there.
    """
    folder = Path(folder).resolve()
    path = folder / f"{int(state.step):08d}"
    if path.exists() and not _damage(path):
        return
    _discard([path, *_unfinished(folder)])
    leaves = {name: np.asarray(leaf) for name, leaf in zip(_names(state), jax.tree.leaves(state), strict=True)}
    content = {"state": leaves, "clock": {name: np.asarray(value) for name, value in clock.items()}}
    try:
        with files.atomic_folder(path) as temporary:
            temporary.rmdir()  # orbax makes it by renaming its own
            _checkpointer().save(temporary, content)
            files.write_json(temporary / CHECKSUMS, _checksums(temporary))
    except (OSError, ValueError) as error:  # tensorstore reports a full disk as a ValueError
        _discard(_unfinished(folder))
        full = getattr(error, "errno", None) == errno.ENOSPC or "No space left" in str(error)
        why = "the disk is full" if full else str(error).splitlines()[0]
        raise ReconstructError(
            "checkpoint cannot be written", where=path, why=why, remedy="free some space, then --resume"
        ) from None
    found = steps(folder)
    now = found.index(path) + 1
    _discard(found[: max(now - KEPT, 0)] + found[now:])  # a later one was damaged, and passed over when this training resumed


def steps(folder: Path) -> list[Path]:
    """Complete checkpoints, oldest first."""
    found = Path(folder).glob("[0-9]" * 8)
    return sorted(path for path in found if path.is_dir())


def state_bytes(state: Any) -> int:
    """Size of a checkpoint of `state`; compression makes it smaller."""
    return sum(leaf.nbytes for leaf in jax.tree.leaves(state))


def load(folder: Path, like: Tree) -> tuple[Tree, dict[str, float]]:
    """State and clock of the newest undamaged checkpoint, in the structure of `like`.

    Raises:
        ReconstructError: there is none, or it was made with another configuration.
    """
    path, content = _newest(folder)
    return _filled(path, like, content["state"], ""), {name: float(value) for name, value in content["clock"].items()}


def load_model(folder: Path, like: Tree, *, other_scene: bool = False) -> tuple[Tree, int]:
    """Model of the newest undamaged checkpoint, in the structure of `like`, and the number of its step. Raises as `load` does.

    Args:
        other_scene: leaves whose length is the scene's stay those of `like`.
    """
    path, content = _newest(folder)
    return _filled(path, like, content["state"], MODEL, other_scene), int(path.name)


def _newest(folder: Path) -> tuple[Path, dict[str, Any]]:
    """The newest checkpoint that is undamaged, and its content; each one passed over is named in a line."""
    found, damage = steps(folder), ""
    for path in reversed(found):
        if not (damage := _damage(path)):
            try:
                content = _checkpointer().restore(path.resolve())
                return path, {name: dict(content[name]) for name in ("state", "clock")}
            except Exception as error:  # of a checkpoint without checksums; orbax and tensorstore raise nearly anything
                damage = f"{type(error).__name__} while reading it"
        if path.exists() and path != found[0]:  # a running training removes old ones
            hint(f"{path}: checkpoint is damaged ({damage}); the one before is used")
    if damage:
        raise ReconstructError("no checkpoint can be read", where=folder, why=damage, remedy="restore it, or train again")
    raise ReconstructError("holds no checkpoint", where=folder, remedy="train first")


def _checksums(path: Path) -> dict[str, str]:
    """SHA-256 of each file of a checkpoint, by its path in it."""
    found = sorted(file for file in path.rglob("*") if file.is_file() and file != path / CHECKSUMS)
    return {str(file.relative_to(path)): files.sha256(file) for file in found}


def _damage(path: Path) -> str:
    """What contradicts the checksums of a checkpoint; empty where nothing does. Runs of older versions have none."""
    try:
        stated = files.read_json(path / CHECKSUMS) if (path / CHECKSUMS).exists() else None
        if stated is None or stated == (found := _checksums(path)):
            return ""
    except (KoalaError, OSError) as error:
        return str(error)
    if not isinstance(stated, dict):
        return f"{CHECKSUMS} holds no table"
    return f"{next(name for name in {**found, **stated} if found.get(name) != stated.get(name))} has changed"


def _unfinished(folder: Path) -> list[Path]:
    """What a kill or a full disk left of checkpoints that were being written or removed."""
    return [path for path in folder.glob("*") if path.name.startswith(".") or ".orbax-checkpoint-tmp" in path.name]


def _discard(paths: list[Path]) -> None:
    """Remove checkpoints so that a kill leaves no part of one under its name."""
    for path in paths:
        if path.exists() and not path.name.startswith("."):
            path = path.replace(path.with_name(f".{path.name}"))
        shutil.rmtree(path, ignore_errors=True)


def _names(tree: Any) -> list[str]:
    """Paths of a tree's leaves."""
    return [jax.tree_util.keystr(path) for path, _ in jax.tree.leaves_with_path(tree)]


def _filled(path: Path, like: Tree, stored: dict[str, Any], prefix: str, other_scene: bool = False) -> Tree:
    """The stored arrays in the structure of `like`, whose paths follow `prefix`."""
    leaves, structure = jax.tree.flatten(like)
    filled = []
    for name, leaf in zip(_names(like), leaves, strict=True):
        if any(part in name for part in MEASURED) or (other_scene and name.endswith(SCENE_SIZED)):
            filled.append(leaf)
            continue
        found = stored.get(prefix + name)
        if found is None or (np.shape(found) != np.shape(leaf) and not name.endswith(SCENE_SIZED)):
            why = f"{name.lstrip('.')} is {_size(found)} in the checkpoint and {_size(leaf)} here"
            raise ReconstructError("checkpoint does not fit the configuration", where=path, why=why, remedy="train again")
        filled.append(jax.numpy.asarray(found, leaf.dtype))
    return jax.tree.unflatten(structure, filled)


def _size(array: Any) -> str:
    return "missing" if array is None else "x".join(map(str, np.shape(array))) or "a number"


def _checkpointer():
    import orbax.checkpoint as ocp

    logging.getLogger("absl").setLevel(logging.ERROR)
    alone = {jax.process_index()}  # of several processes one writes, and each reads by itself
    options = ocp.options.MultiprocessingOptions(primary_host=jax.process_index(), active_processes=alone)
    return ocp.Checkpointer(ocp.PyTreeCheckpointHandler(multiprocessing_options=options), multiprocessing_options=options)
