"""Poses as nothing but numbers: in lines of text (NumPy's savetxt, TUM's trajectories) and in .npy files."""

import re
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.calib.sessions.description import Description
from koala3d.datasets.core import arrays, files
from koala3d.datasets.core.errors import DatasetError

MAX_BYTES = 2**24


def read_lines(path: Path, description: Description, images: Collection[str]) -> dict[str, Any] | list[Any]:
    """Numbers of each line; or of each matrix, of four numbers a line. By name if each line begins with the name of an image, in
    order otherwise: the time stamps of a TUM trajectory count as names if `images` are named by them.

    Raises DatasetError if the lines are not what the layout says.
    """
    text = files.read_text(path, MAX_BYTES, suffixes=(".txt",))
    lines = [re.split(r"[,;\s]+", line) for part in text.splitlines() if (line := part.partition("#")[0].strip(" \t,;\r"))]
    widths, sizes = sorted({len(line) for line in lines}), _sizes(description)
    labels = 1 if len(widths) == 1 and widths[0] not in sizes and widths[0] - 1 in sizes else 0
    if words := next((line for line in lines if not all(map(_is_number, line[labels:]))), None):
        why, remedy = " ".join(words)[:60], "begin lines that are no poses with #"
        raise DatasetError("line is not made of numbers", where=path, why=why, remedy=remedy)
    if len(widths) == 1 and widths[0] in sizes:
        return lines
    if labels and _are_labelled(lines, description):
        return _by_label(lines, images, path)
    if widths == [4] and "matrix" in description.layout and (blocks := _blocks(lines, description)):
        return blocks
    why = f"lines have {' to '.join(map(str, dict.fromkeys((widths[0], widths[-1]))))} numbers" if widths else "it is empty"
    remedy = f"layout {description.layout!r} has {' or '.join(map(str, sizes))} numbers"
    raise DatasetError("does not hold such poses", where=path, why=why, remedy=remedy)


def _by_label(lines: list[list[str]], images: Collection[str], path: Path) -> dict[str, Any] | list[Any]:
    """Numbers by the first word of each line; in order if these are times and no names of images."""
    found = {line[0]: line[1:] for line in lines}
    if len(found) < len(lines):
        raise DatasetError("two lines begin with one name", where=path)
    return found if not all(map(_is_number, found)) or set(found) & set(images) else list(found.values())


def read_npy(path: Path, description: Description) -> list[Any]:
    """Numbers of each pose of an array (n, 4, 4), (n, 3, 4) or (n, numbers of the layout), or of one pose.

    Raises DatasetError for other arrays; nothing is unpickled.
    """
    array, sizes = arrays.read_npy(path), _sizes(description)
    if "matrix" in description.layout and array.shape[-2:] in ((4, 4), (3, 4)):
        array = array.reshape(*array.shape[:-2], -1)
    if array.dtype.kind not in "fiu" or array.ndim not in (1, 2) or array.shape[-1] not in sizes:
        why = f"shape {array.shape}, type {array.dtype}; layout {description.layout!r} has {' or '.join(map(str, sizes))} numbers"
        raise DatasetError("does not hold such poses", where=path, why=why, remedy="save an array (poses, numbers)")
    return list(array.reshape(-1, array.shape[-1]).astype(np.float64).tolist())


def _sizes(description: Description) -> list[int]:
    """How many numbers a pose may have: a matrix may lack its last row."""
    return [12, 16] if "matrix" in description.layout else [len(description.columns)]


def _are_labelled(lines: list[list[str]], description: Description) -> bool:
    """Whether lines with one word too many begin with a name, or a time. Three angles and a number may be a quaternion."""
    return not (description.has_angles and any(_is_number(line[0]) for line in lines))


def _blocks(lines: list[list[str]], description: Description) -> list[list[str]]:
    """The numbers of matrices that follow each other, of four rows or three; nothing if lines are left over."""
    rows = 4
    if description.layout == "matrix" and len(lines) % 3 == 0:
        last = [list(map(float, line)) for line in lines[3::4]]
        rows = 4 if len(lines) % 4 == 0 and all(line == [0, 0, 0, 1] for line in last) else 3
    if len(lines) % rows:
        return []
    return [[word for line in lines[start : start + rows] for word in line] for start in range(0, len(lines), rows)]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
