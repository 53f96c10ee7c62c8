"""Target files of Kalibr, whose keys differ from ours: tagCols, tagSize, tagSpacing and others."""

from typing import Any

KEYS = {
    "aprilgrid": ("tagCols", "tagRows", "tagSize", "tagSpacing"),
    "checkerboard": ("targetCols", "targetRows", "rowSpacingMeters", "colSpacingMeters"),
}
"""What a file of each kind must hold."""


def board(content: dict[str, Any]) -> dict[str, Any]:
    """A target of Kalibr in the keys of `Board`. Raises ValueError, which says what to write instead, for one that is not read.

    Kalibr counts the inner corners of a checkerboard, and states the gap between tags as a share of the tag.
    """
    kind = str(content["target_type"])
    if kind not in KEYS:
        ours = "circles, with square_length_m = spacingMeters and the diameter as marker_length_m"
        remedy = f"write it as {ours}" if kind == "circlegrid" else f"possible are {' and '.join(KEYS)}"
        raise ValueError(f"target_type {kind!r} of Kalibr is not read: {remedy}")
    if absent := [key for key in KEYS[kind] if not _is_number(content.get(key))]:
        raise ValueError(f"Kalibr's {kind} needs a number for {absent[0]!r}")
    columns, rows, first, second = (content[key] for key in KEYS[kind])
    if not (float(columns).is_integer() and float(rows).is_integer()):
        raise ValueError(f"{KEYS[kind][0]} and {KEYS[kind][1]} are whole numbers: {columns} and {rows} given")
    if kind == "aprilgrid":
        sizes = {"square_length_m": first * (1 + second), "marker_length_m": first}
        return {"kind": kind, "squares_x": columns, "squares_y": rows, "first_id": content.get("codeOffset", 0), **sizes}
    if first != second:
        raise ValueError(f"squares must be square: rowSpacingMeters is {first}, colSpacingMeters {second}")
    return {"kind": "chessboard", "squares_x": columns + 1, "squares_y": rows + 1, "square_length_m": first}


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
