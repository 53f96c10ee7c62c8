"""Poses in a table with a header (CSV), as spreadsheets and scripts write it.

Columns are `image` and the words of the layout, in any order and in small or capital letters; a unit may follow: x_mm, rx [deg].
Commas, semicolons or tabs stand between, lines that begin with # are comments, and the decimal mark is a point or a comma.
"""

import csv
import io
import re
from pathlib import Path
from typing import Any

from koala3d.calib.sessions.description import Description
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, UsageError, nearest

MAX_BYTES = 2**24
LENGTHS = ("x", "y", "z", "m03", "m13", "m23")
_UNIT = re.compile(r"(?P<name>.+?)(?:[ _]+(?P<bare>mm|cm|m|deg|rad)|[ _]*[\[(](?P<framed>[^\])]*)[\])])")
_KNOWN_UNITS = {"°": "deg", "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad"}


def read(path: Path, description: Description) -> dict[str, Any] | list[Any]:
    """Numbers by the name of the image; in the order of the lines if there is no such column.

    Raises:
        DatasetError: it is no table, lacks a column, has one too many, or lists an image twice.
        UsageError: a unit differs from the description's.
    """
    header, rows = _split(path)
    columns = [_column(name, description, path) for name in header]
    _check(columns, description, path)
    wanted = [name for name in description.columns if name in columns]
    table = [dict(zip(columns, row, strict=True)) for row in _decimal_points(rows, columns, path)]
    if "image" not in columns:
        return [[row[name] for name in wanted] for row in table]
    found: dict[str, Any] = {}
    for row in table:
        if row["image"] in found:
            raise DatasetError("image is listed twice", where=path, why=row["image"], remedy="keep one of its lines")
        found[row["image"]] = [row[name] for name in wanted]
    return found


def _split(path: Path) -> tuple[list[str], list[list[str]]]:
    """The words of the header and of each line after it, as many as the header has."""
    text = files.read_text(path, MAX_BYTES, suffixes=(".csv",))
    lines = [line for line in text.splitlines() if line.strip(' \t;,"') and not line.lstrip(' "').startswith("#")]
    stated = re.fullmatch('"?sep=([,;\t])"?', lines[0]) if lines else None  # a hint to Excel, which leaves it in the file
    lines = lines[1:] if stated else lines
    if not lines:
        raise DatasetError("is empty", where=path, remedy="write a header and a line for each pose")
    between = stated[1] if stated else max(",;\t", key=lines[0].count)
    try:
        reader = csv.reader(io.StringIO("\n".join(lines), newline=""), delimiter=between, skipinitialspace=True)
        header, *rows = [[word.strip() for word in row] for row in reader]
    except csv.Error as error:
        raise DatasetError("is not a CSV file", where=path, why=str(error)) from None
    while header and not header[-1]:  # some programs end each line with a separator
        header.pop()
    for row in rows:
        while len(row) > len(header) and not row[-1]:
            row.pop()
        if len(row) != len(header):
            why = f"{len(row)} words, the header has {len(header)}: {', '.join(row)[:60]}"
            remedy = "put semicolons between, or quote numbers with a decimal comma" if between == "," else "complete it"
            raise DatasetError("line does not fit the header", where=path, why=why, remedy=remedy)
    return header, rows


def _column(title: str, description: Description, path: Path) -> str:
    """The name of a column by its title. Raises UsageError if the title has a unit that the description does not have."""
    name = title.lower()
    if name in ("image", *description.columns) or not (parts := _UNIT.fullmatch(name)):
        return name
    name, unit = parts["name"].strip(), (parts["bare"] or parts["framed"]).strip()
    if name not in description.columns:
        return title
    unit = _KNOWN_UNITS.get(unit, unit)
    key, valid = ("length", ("m", "mm")) if name in LENGTHS else ("angle", ("rad", "deg"))
    if unit != (stated := getattr(description, key)):
        remedy = f"say {key}: {unit} in the description" if unit in valid else f"possible are {' and '.join(valid)}"
        raise UsageError(
            f"column {title!r} has another unit than the description", where=path, why=f"{key}: {stated}", remedy=remedy
        )
    return name


def _check(columns: list[str], description: Description, path: Path) -> None:
    """Raise DatasetError if columns are missing, unknown or there twice."""
    optional = {name for name in description.columns if "m3" in name}  # the last row of a matrix
    needed = [name for name in description.columns if name not in optional or optional & set(columns)]
    known, there = ["image", *description.columns], f"it has {', '.join(columns)}"
    unknown = [name for name in columns if name not in known]
    absent = [name for name in needed if name not in columns]
    if absent:
        remedy = f"the first line names the columns: [image,] {description.layout}"
        raise DatasetError(f"no column {absent[0]!r}", where=path, why=there[:200], remedy=remedy)
    if unknown:
        remedy = f"remove it, or correct it: {nearest(unknown[0], known)}"
        raise DatasetError(f"unknown column {unknown[0]!r}", where=path, why=there[:200], remedy=remedy)
    if len(set(columns)) < len(columns):
        raise DatasetError("two columns have one name", where=path, why=there[:200])


def _decimal_points(rows: list[list[str]], columns: list[str], path: Path) -> list[list[str]]:
    """The rows with points for decimal commas. Raises DatasetError where commas and points are mixed: thousands, or decimals?"""
    numbers = [column for column, name in enumerate(columns) if name != "image"]
    commas = [row[column] for row in rows for column in numbers if "," in row[column]]
    if commas and (points := [row[column] for row in rows for column in numbers if "." in row[column]]):
        remedy = "write one decimal mark and nothing between thousands"
        raise DatasetError("numbers have commas and points", where=path, why=f"{commas[0]} and {points[0]}", remedy=remedy)
    if not commas:
        return rows
    return [[word.replace(",", ".") if column in numbers else word for column, word in enumerate(row)] for row in rows]
