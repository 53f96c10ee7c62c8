"""Install Koala for every Python on this machine and use what was installed: `make install-check`.

Each Python gets a fresh virtual environment and a plain, not editable installation of everything that has wheels for it, from
a copy of the checkout, after Hugging Face's `datasets`; that is then installed once more, over Koala, and both are used. The four
commands print their help, a scene is made and read, a model trains for 20 steps, and the simulated arm records a calibration
session through the robot client of this installation; the camera is calibrated from it. Standard library only.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
OLDEST = (3, 11)
VIEWS = 12
NEIGHBOUR = "datasets"
"""Hugging Face's package, which has the name of one of our commands and folders. Most who train models have it."""
BOTH = """
import datasets
from koala3d.datasets.camera_model import Camera
assert datasets.Dataset.from_dict({"view": [0, 1]}).num_rows == 2 and Camera(4, 3, 5.0, 5.0, 2.0, 1.5).width == 4
"""
COMMANDS = ("capture", "calib", "datasets", "reconstruct")


class CheckFailed(Exception):
    """A step failed; the message names it and ends with the last lines that it printed."""


def pythons() -> dict[str, Path]:
    """Version ('3.12') to interpreter: every Python on PATH and in pyenv that is new enough, the newest patch release of each."""
    found: dict[tuple[int, ...], Path] = {}
    for path in _candidates():
        try:
            done = subprocess.run([path, "--version"], capture_output=True, text=True, timeout=20)
        except (OSError, subprocess.TimeoutExpired):
            continue  # a broken interpreter is none
        match = re.fullmatch(r"Python (\d+)\.(\d+)\.(\d+)\S*\s*", done.stdout)
        if done.returncode == 0 and match:
            found.setdefault(tuple(map(int, match.groups())), path)
    newest = {version[:2]: path for version, path in sorted(found.items()) if version[:2] >= OLDEST}
    return {f"{major}.{minor}": path for (major, minor), path in newest.items()}


def _candidates() -> Iterator[Path]:
    for folder in os.environ.get("PATH", "").split(os.pathsep):
        yield from sorted(path for path in Path(folder).glob("python3.*") if re.fullmatch(r"python3\.\d+", path.name))
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    yield from sorted(pyenv.glob("versions/*/bin/python"))


class Installation:
    """One virtual environment with Koala in it, in a folder that holds everything that the check makes."""

    def __init__(self, folder: Path, version: str) -> None:
        self.folder, self.version = folder, version
        self.bin = folder / "venv" / "bin"

    def install(self, python: Path) -> None:
        """Create the environment and install a copy of the checkout with all extras, at locked versions if there are any."""
        self.run(str(python), "-m", "venv", str(self.folder / "venv"))
        source = self.folder / "source"
        shutil.copytree(
            ROOT, source, ignore=shutil.ignore_patterns(".*", "build", "demo", "runs", "koala", "*.egg-info", "__pycache__")
        )
        lock = ROOT / "constraints" / f"python{self.version}.txt"
        constraint = ["--constraint", str(lock)] if lock.is_file() else []
        self.pip(*constraint, NEIGHBOUR)
        self.pip(*constraint, f"{source}[all]")

    def pip(self, *words: str) -> None:
        """Install something more into the environment."""
        self.run(str(self.bin / "python"), "-m", "pip", "install", "--quiet", "--no-compile", *words)

    def beside(self) -> str:
        """Koala and Hugging Face's `datasets` work in one environment, whichever was installed last."""
        self.run(str(self.bin / "python"), "-c", BOTH)
        self.pip("--force-reinstall", "--no-deps", NEIGHBOUR)
        self.run(str(self.bin / "python"), "-c", BOTH)
        return "ok"

    def run(self, *command: str) -> str:
        """Standard output of a command. Raises CheckFailed where it fails."""
        environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
        done = subprocess.run(command, cwd=self.folder, env=environment, capture_output=True, text=True)
        if done.returncode:
            last = (done.stderr or done.stdout).strip().splitlines()[-8:]
            raise CheckFailed(f"{' '.join(command)} failed:\n  " + "\n  ".join(last))
        return done.stdout

    def koala(self, *command: str) -> str:
        """Standard output of one of our commands."""
        return self.run(str(self.bin / command[0]), *command[1:])

    def help(self) -> str:
        """The four commands explain themselves."""
        for command in COMMANDS:
            if "Usage" not in self.koala(command, "--help"):
                raise CheckFailed(f"{command} --help does not show how to use it")
        return "ok"

    def train(self) -> str:
        """Make and read a scene, train on it for 20 steps."""
        self.koala("reconstruct", "scenes", "--scene", "gold_rings", "--size", "32", "--train", "8", "--test", "2", "--out", "s")
        views = sum(json.loads(self.koala("datasets", "info", "s/gold_rings", "--json"))["views"].values())
        settings = ["--set", "train.steps=20", "--set", "sampler.samples=2048"]
        result = json.loads(self.koala("reconstruct", "train", "s/gold_rings", *settings, "--out", "run", "--json"))
        return f"{views} views, {result['steps']} steps, {result['psnr_train']:.1f} dB"

    def calibrate(self) -> str:
        """Record a session with the simulated arm and calibrate the camera from it."""
        small = ["--set", f"views.0.count={VIEWS}", "--time-scale", "50"]
        self.koala("capture", "run", "calibration_demo", "--scene", "board", *small, "--out", "board")
        robot = json.loads((self.folder / "board" / "manifest.json").read_text(encoding="utf-8"))["robot"]
        self.koala("calib", "handeye", "board", "--out", "calibration.json")
        truth = json.loads(self.koala("datasets", "truth", "board", "--calibration", "calibration.json", "--json"))
        error = f"{truth['hand_eye_mm']:.2f} mm, {truth['hand_eye_deg']:.3f} deg"
        return f"{VIEWS} views through {robot['client']}; error of the hand-eye pose {error}"


def check(version: str, python: Path) -> bool:
    """Check one Python; print one line per step. Whether all of them passed."""
    with tempfile.TemporaryDirectory(prefix="koala-install-") as folder:
        installed = Installation(Path(folder), version)
        steps = {
            "install": lambda: installed.install(python) or "ok",
            "beside another datasets": installed.beside,
            "help": installed.help,
            "train": installed.train,
            "capture and calibrate": installed.calibrate,
        }
        for name, step in steps.items():
            begun = time.monotonic()
            try:
                said, passed = step(), True
            except CheckFailed as error:
                said, passed = f"FAILED: {error}", False
            sys.stdout.write(f"Python {version}  {name:<24} {time.monotonic() - begun:4.0f} s  {said}\n")
            sys.stdout.flush()
            if not passed:
                return False
    return True


def main() -> None:
    """Check the Pythons named on the command line, or all that are found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("versions", nargs="*", metavar="3.12", help="Check these versions only.")
    parser.add_argument("--one-other", action="store_true", help="Check the newest Python that is not the one running this.")
    options = parser.parse_args()
    found = pythons()
    if missing := [version for version in options.versions if version not in found]:
        parser.error(f"no Python {', '.join(missing)} on this machine; found: {', '.join(found) or 'none'}")
    chosen = options.versions or list(found)
    if options.one_other:
        own = f"{sys.version_info.major}.{sys.version_info.minor}"
        chosen = [version for version in chosen if version != own][-1:]
        if not chosen:
            sys.stdout.write(f"no other Python than {own} on this machine: nothing to check\n")
    passed = [check(version, found[version]) for version in chosen]
    sys.exit(0 if all(passed) else 1)


if __name__ == "__main__":
    main()
