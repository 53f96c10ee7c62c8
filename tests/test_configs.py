"""Every file in configs/ loads with the schema that reads it, and is found by its name."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from koala3d import configs
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.schema import read_yaml

CONFIGS = Path(__file__).parent.parent / "configs"
FILES = sorted(CONFIGS.rglob("*.yaml"))


def loader(folder: str) -> Callable[[Path], Any]:
    """The function that reads the files of one folder below configs/."""
    if folder == "trajectories":
        from koala3d.capture.model.trajectory import load_trajectory

        return load_trajectory
    if folder == "boards":
        from koala3d.datasets.targets.board import load_board

        return load_board
    if folder == "rigs":
        from koala3d.capture.model.rig import load_rig

        return load_rig
    if folder == "arms":
        from koala3d.capture.model.arm import load_arm

        return load_arm
    if folder == "imports":
        from koala3d.calib.sessions.description import load_description

        return load_description
    if folder == "models":
        from koala3d.reconstruct.models import PRESETS, load_config

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
    from koala3d.capture.model.trajectory import load_trajectory

    views = load_trajectory(path).viewpoints()
    assert len({view.name for view in views}) == len(views) > 1
    assert {view.split for view in views} in ({"train", "test"}, {"train"}, {"calibration"})


@pytest.mark.parametrize("kind", sorted(configs.KINDS))
def test_every_kind_is_found_by_name_and_described_in_one_line(kind: str) -> None:
    shipped = configs.shipped(kind)
    assert shipped and list(shipped) == sorted(path.stem for path in FILES if path.parent.name == kind)
    for name, description in shipped.items():
        assert configs.find(kind, name) == CONFIGS / kind / f"{name}.yaml"
        assert description[0].isupper() and 20 < len(description) <= 130, name


def test_the_folders_are_the_kinds() -> None:
    assert {path.parent.name for path in FILES} == set(configs.KINDS)


def test_a_path_is_left_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for path in ("koala.yaml", "mine/koala", tmp_path / "koala"):
        assert configs.find("trajectories", path) == Path(path)
    Path("koala").mkdir()  # a recording of that name does not hide the trajectory
    assert configs.find("trajectories", "koala") == CONFIGS / "trajectories" / "koala.yaml"
    Path("koala").rmdir()
    Path("koala").touch()
    assert configs.find("trajectories", "koala") == Path("koala")


@pytest.mark.parametrize(
    ("kind", "name", "words"),
    [
        (
            "trajectories",
            "koala_dmo",
            ["no trajectory 'koala_dmo'", "calibration, calibration_demo", "did you mean 'koala_demo'?"],
        ),
        (
            "rigs",
            "arm2",
            [
                "no rig 'arm2'",
                "known: franka_basler, franka_realsense, sim_flawed, ur10e_gige, ur5e_basler, ur5e_beside, ur5e_second, "
                "ur5e_stereo, ur5e_turntable",
                "the path of a file",
            ],
        ),
        ("imports", "franka_charco", ["no import description", "did you mean 'franka_charuco'?"]),
    ],
)
def test_an_unknown_name_is_answered_by_the_nearest_and_the_list(kind: str, name: str, words: list[str]) -> None:
    with pytest.raises(UsageError) as caught:
        configs.find(kind, name)
    assert [part for part in words if part not in str(caught.value)] == []
