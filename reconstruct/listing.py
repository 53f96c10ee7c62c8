"""Listings of what can be chosen: the models, and every setting of a configuration."""

from collections.abc import Iterator, Sequence
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from koala3d.reconstruct.config import Config, Overlays

CHOSEN_ELSEWHERE = ("model", "preset", "kinds")  # options of their own, or decided by a training


def settings(config: Config) -> list[dict[str, Any]]:
    """Key, type, value in `config` and meaning of everything that `--set` takes."""
    return [row for row in _fields(config, "") if row["key"] not in CHOSEN_ELSEWHERE]


def _fields(section: BaseModel, prefix: str) -> Iterator[dict[str, Any]]:
    for name, field in type(section).model_fields.items():
        value = getattr(section, name)
        if isinstance(value, Overlays):
            continue
        if isinstance(value, BaseModel):
            yield from _fields(value, f"{prefix}{name}.")
        else:
            kind = _type_name(field.annotation)
            bare = kind.removesuffix("|null")
            kind = bare + _bounds(field) + kind[len(bare) :]
            yield {"key": f"{prefix}{name}", "type": kind, "default": value, "meaning": field.description or ""}


def _type_name(annotation: Any) -> str:
    """A type as `--set` takes it: "float", "true|false", "[float, float]", "lattice|voxels"."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _type_name(inner[0]) + _bounds(inner[1])
    if origin is Literal:
        return "|".join(map(str, inner))
    if origin in (Union, UnionType):
        return "|".join("null" if one is NoneType else _type_name(one) for one in inner)
    if origin is tuple:
        return f"[{', '.join('...' if one is Ellipsis else _type_name(one) for one in inner)}]"
    names = {bool: "true|false", str: "text", int: "int", float: "float"}
    return names[annotation]


def _bounds(field: FieldInfo) -> str:
    """The range of a number, as " > 0, <= 1"."""
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<=", "multiple_of": "multiple of"}
    limits = [f"{sign} {getattr(one, name):g}" for one in field.metadata for name, sign in signs.items() if hasattr(one, name)]
    return f" {', '.join(limits)}" if limits else ""


def settings_text(rows: Sequence[dict[str, Any]]) -> str:
    """The settings as an aligned table."""
    return aligned(
        [("key", "type", "default", "meaning"), *((r["key"], r["type"], _shown(r["default"]), r["meaning"]) for r in rows)]
    )


def _shown(value: Any) -> str:
    """A value as `--set` takes it."""
    if value is None or isinstance(value, bool):
        return "null" if value is None else str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(map(_shown, value))}]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def models_text(rows: Sequence[dict[str, Any]]) -> str:
    """`models.overview` as an aligned table."""
    head = ("model", "encoding", "appearance", "regularisers", "about")
    body = ((r["name"], r["encoding"], r["appearance"], ", ".join(r["regularisers"]) or "-", r["about"]) for r in rows)
    return aligned([head, *body])


def aligned(lines: Sequence[Sequence[str]]) -> str:
    """Rows with aligned columns, the last one as long as it is."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines)
