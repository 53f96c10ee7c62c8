"""That the steps of Containerfile are such as `container.py` carries out, and name what is there."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def container():
    spec = importlib.util.spec_from_file_location("container_check", Path(__file__).with_name("container.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_steps_are_known_and_their_targets_exist(container) -> None:
    found = container.steps((ROOT / "Containerfile").read_text())
    assert found[0] == ("FROM", "docker.io/library/debian:trixie") and {name for name, _ in found} == container.STEPS
    targets = [word for name, words in found if name == "RUN" for word in re.findall(r"make (\S+)", words)]
    makefile = (ROOT / "Makefile").read_text().replace("$(READY)", ".venv/.ready")
    assert targets == ["python3", "tools", ".venv/.ready"] and all(f"\n{target}:" in makefile for target in targets[1:])


def test_an_unknown_step_is_refused(container) -> None:
    with pytest.raises(ValueError, match="not understood: ADD"):
        container.steps("FROM a\nADD b c\n")


def test_settings_reach_the_steps_and_the_working_directory_holds(container, tmp_path: Path) -> None:
    chroot = container.Chroot(tmp_path)
    chroot.carry_out("ENV", "COLOUR=red=green")
    chroot.carry_out("WORKDIR", "/koala")
    assert chroot.environment["COLOUR"] == "red=green" and chroot.inside == "/koala" and (tmp_path / "koala").is_dir()
