"""Every file in configs/ loads with the schema that reads it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from datasets.core.schema import read_yaml

CONFIGS = Path(__file__).parent.parent / "configs"
FILES = sorted(CONFIGS.rglob("*.yaml"))


def loader(folder: str) -> Callable[[Path], Any]:
    """The function that reads the files of one folder below configs/."""
    if folder == "trajectories":
        from capture.trajectory import load_trajectory

        return load_trajectory
    if folder == "rigs":
        from capture.rig.description import load_rig

        return load_rig
    if folder == "imports":
        from calib.sessions.importer import load_description

        return lambda path: load_description(path.parent, path)
    if folder == "models":
        from reconstruct.models import PRESETS, load_config

        return lambda path: [load_config(path.stem, preset) for preset in PRESETS]
    raise AssertionError(f"configs/{folder} holds files, but no reader is known for them: add it here")


def test_there_are_files() -> None:
    assert FILES
    assert not [path for path in CONFIGS.rglob("*.yml")], "configuration files end in .yaml"


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(CONFIGS)))
def test_it_loads(path: Path) -> None:
    read_yaml(path)  # refuses keys that are given twice
    assert loader(path.relative_to(CONFIGS).parts[0])(path)


@pytest.mark.parametrize("path", [path for path in FILES if path.parent.name == "trajectories"], ids=lambda path: path.stem)
def test_trajectories_have_views_and_a_split(path: Path) -> None:
    from capture.trajectory import load_trajectory

    views = load_trajectory(path).viewpoints()
    assert len({view.name for view in views}) == len(views) > 1
    assert {view.split for view in views} in ({"train", "test"}, {"train"}, {"calibration"})
