"""The decisions of a training, as RUN/skips.json keeps them and as a person reads them."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError, nearest
from koala3d.reconstruct.config import SkipConfig
from koala3d.reconstruct.run import SKIPS
from koala3d.reconstruct.training.decisions import exposure, lamps, poses
from koala3d.reconstruct.training.decisions.skip import Skip

LEARNED = {exposure.NAME: exposure.FORCED, poses.NAME: poses.FORCED}
"""What is learned beside the model if a scene needs it, and the setting that forces it."""
NAMES = (*SkipConfig.model_fields, *LEARNED)
"""What can be forced."""


def left_out(skips: Sequence[Skip]) -> list[str]:
    """A line for each thing that was left out and saved something: what, why, what that saved."""
    listed = [skip for skip in skips if skip.skipped and skip.saving and skip.name in SkipConfig.model_fields]
    return [f"{skip.what}: {skip.evidence}; saves {skip.saving}" for skip in listed]


def learned(skips: Sequence[Skip]) -> list[str]:
    """A line for each thing that is learned beside the model: what and why."""
    return [f"{skip.what}: {skip.evidence}" for skip in skips if skip.name in LEARNED and not skip.skipped]


def forced(names: Sequence[str]) -> list[str]:
    """Overrides of the configuration that keep the named things from being skipped. Raises UsageError for an unknown name."""
    for name in names:
        if name == lamps.NAME:
            raise UsageError(
                f"{name} is decided elsewhere", where="--no-skip", remedy="set light.frame: world, camera or turntable"
            )
        if name not in NAMES:
            raise UsageError(f"there is no skip '{name}'", where="--no-skip", remedy=nearest(name, NAMES))
    return [LEARNED.get(name, f"skip.{name}=false") for name in names]


def write(run: Path, skips: Sequence[Skip]) -> None:
    """Put the decisions into a run's folder, in place of those that are there."""
    files.write_json(run / SKIPS, [asdict(skip) for skip in skips])


def read(run: Path) -> list[Skip]:
    """The decisions of a run; none where it has no list."""
    path = run / SKIPS
    return [Skip(**entry) for entry in files.read_json(path)] if path.is_file() else []
