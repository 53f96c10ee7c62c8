"""Configuration files that are installed with Koala, found by name: models, trajectories, boards, rigs, arms, imports.

`configs/KIND/NAME.yaml` has the name NAME. The first comment line of a file, or its key `about`, says what it is.
"""

from importlib.resources import files
from pathlib import Path

from koala3d.datasets.core.errors import UsageError, nearest

KINDS = {
    "models": "model",
    "trajectories": "trajectory",
    "boards": "calibration target",
    "rigs": "rig",
    "arms": "arm",
    "imports": "import description",
}
"""Folder of each kind, and what one of its files is called in messages."""


def find(kind: str, name: Path | str, *, others: tuple[str, ...] = ()) -> Path:
    """The file that a user means by `name`: an existing file, the path of one, or a shipped file by its name.

    A name has neither a folder nor a suffix. Whether a path exists is left to whoever reads it.

    Args:
        kind: a key of `KINDS`.
        name: name or path.
        others: further names to list in the message, which the caller knows.

    Raises:
        UsageError: no shipped file has that name; the message gives the nearest name and lists all of them.
    """
    path = Path(name)
    if path.is_file() or path.suffix or len(path.parts) != 1:
        return path
    found = {file.stem: file for file in _files(kind)}
    if path.name in found:
        return found[path.name]
    names = [*others, *found]
    advice = nearest(path.name, names)
    raise UsageError(
        f"there is no {KINDS[kind]} '{name}'",
        why=f"known: {', '.join(names)}",
        remedy=advice if advice.startswith("did you mean") else "give one of these names, or the path of a file",
    )


def shipped(kind: str) -> dict[str, str]:
    """Name of each shipped file of a kind, with its description in one line."""
    return {file.stem: _description(file) for file in _files(kind)}


def _files(kind: str) -> list[Path]:
    return sorted((Path(str(files("koala3d.configs"))) / kind).glob("*.yaml"))


def _description(path: Path) -> str:
    first = path.read_text(encoding="utf-8").split("\n", 1)[0]
    return first.removeprefix("#").removeprefix("about:").strip()
