"""Build the wheel and the source distribution into build/package, look at them and use them: `make package`.

Both must hold each file of the packages and nothing else; PyPI must be able to show the description; the wheel's commands must
start in an environment that nothing but the wheel made. Standard library only; uv and twine lie beside the Python that runs this.
"""

import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
OUT = ROOT / "build" / "package"
FOLDERS = ("capture", "calib", "reconstruct", "datasets", "configs")
KINDS = (".py", ".yaml", ".urdf", ".html")
"""Suffixes of what the packages hold."""
BESIDE = {"README.md", "CITATION.cff", "MANIFEST.in", "pyproject.toml", "setup.py", "setup.cfg", "PKG-INFO"}
"""What else a source distribution holds."""
COMMANDS = ("capture", "calib", "datasets", "reconstruct")


class PackageFailed(Exception):
    """What is wrong, in one line."""


def wanted(root: Path) -> set[str]:
    """Files of the packages in a checkout, relative to it."""
    found = (path for folder in FOLDERS for path in (root / folder).rglob("*") if "__pycache__" not in path.parts)
    return {path.relative_to(root).as_posix() for path in found if path.suffix in KINDS}


def in_wheel(path: Path) -> set[str]:
    """The same of a wheel: what is below `koala3d`. Other names are returned as they are, to be noticed."""
    names = zipfile.ZipFile(path).namelist()
    return {name.removeprefix("koala3d/") for name in names if ".dist-info/" not in name}


def in_source(path: Path) -> set[str]:
    """The same of a source distribution."""
    with tarfile.open(path) as archive:
        names = {member.name.partition("/")[2] for member in archive.getmembers() if member.isfile()}
    return {name for name in names if name not in BESIDE and ".egg-info/" not in name}


def compare(found: set[str], expected: set[str], title: str) -> None:
    """Raise PackageFailed where two sets of files differ."""
    for which, names in (("lacks", expected - found), ("should not hold", found - expected)):
        if names:
            raise PackageFailed(f"the {title} {which} {len(names)} files: {', '.join(sorted(names)[:5])}")


def run(program: str, *words: object) -> str:
    """Standard output of a program that is beside this Python. Raises PackageFailed where it fails."""
    done = subprocess.run(
        [Path(sys.executable).with_name(program), *map(str, words)], cwd=ROOT, capture_output=True, text=True, timeout=900
    )
    if done.returncode:
        raise PackageFailed(f"{program} {words[0]} failed:\n{(done.stdout + done.stderr).strip()[-2000:]}")
    return done.stdout


def cited_version(root: Path) -> str:
    """The version in CITATION.cff. Raises PackageFailed where it is not that of the project."""
    version = tomllib.loads((root / "pyproject.toml").read_text())["project"]["version"]
    found = re.search(r"^version: (\S+)$", (root / "CITATION.cff").read_text(), re.M)
    if found is None or found[1] != version:
        raise PackageFailed(f"CITATION.cff is of version {found and found[1]}, pyproject.toml of {version}")
    return str(version)


def check() -> None:
    """Build and check everything. Raises PackageFailed."""
    version = cited_version(ROOT)
    shutil.rmtree(OUT, ignore_errors=True)
    run("uv", "build", "--quiet", "--out-dir", OUT, ".")
    wheel, source = next(OUT.glob("*.whl")), next(OUT.glob("*.tar.gz"))
    compare(in_wheel(wheel), wanted(ROOT), "wheel")
    compare(in_source(source), wanted(ROOT), "source distribution")
    run("twine", "check", "--strict", wheel, source)
    run("uv", "tool", "run", "--quiet", "cffconvert", "--validate", "--infile", "CITATION.cff")
    lock = ROOT / "constraints" / f"python{sys.version_info.major}.{sys.version_info.minor}.txt"
    fixed = ["--python", sys.executable, "--find-links", OUT, *(["--constraints", lock] if lock.is_file() else [])]
    for command in COMMANDS:
        shown = run("uv", "tool", "run", "--quiet", *fixed, "--from", f"koala-capture=={version}", command, "--help")
        if not shown.startswith("Usage:"):
            raise PackageFailed(f"{command} --help of the wheel does not show how to use it")
    print(f"{wheel.name} and {source.name} are complete, and their commands start")


if __name__ == "__main__":
    try:
        check()
    except PackageFailed as error:
        sys.exit(f"error: {error}")
