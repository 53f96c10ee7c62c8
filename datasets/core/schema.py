"""Configuration files: YAML read against one typed schema, with every mistake reported in one line with file and line number.

    class Trajectory(Schema):
        speed: float = Field(1.0, gt=0, description="joint speed [rad/s]")

    trajectory = load_yaml(path, Trajectory, overrides=["speed=0.5"])

Unknown keys, keys given twice, wrong types and impossible values raise UsageError; so does a file that is missing or is not YAML.
"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from koala3d.datasets.core import plain_yaml
from koala3d.datasets.core.errors import UsageError, nearest

Place = tuple[str | int, ...]


class Schema(BaseModel):
    """Base of all configuration: frozen, finite, without undeclared keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)


Model = TypeVar("Model", bound=BaseModel)


def load_yaml(path: Path | str, model: type[Model], *, overrides: Sequence[str] = ()) -> Model:
    """Read a YAML file as a `model`.

    Args:
        overrides: "a.b=value" with value in YAML, "a.0.b=value" inside a list, applied before validation; the last one wins.

    Raises UsageError: in one line, with the file, the line number, the key and what would have been valid.
    """
    content, lines = read_yaml(path)
    return validate(content, model, where=path, lines=lines, overrides=overrides)


def read_yaml(path: Path | str) -> tuple[dict[str, Any], dict[Place, int]]:
    """Contents of a YAML file, and the line number of each key; raises UsageError where it is missing or no mapping."""
    return parse_yaml(plain_yaml.read_text(Path(path)), where=path)


def parse_yaml(text: str, *, where: object) -> tuple[dict[str, Any], dict[Place, int]]:
    """`read_yaml` of a text; `where` names it in errors."""
    root = plain_yaml.compose(text, where=where)
    if not isinstance(root, yaml.MappingNode):
        raise UsageError("holds no keys", where=where, remedy="write 'key: value' lines")
    lines: dict[Place, int] = {}
    _note_lines(root, (), lines, where)
    return plain_yaml.construct(root, where=where), lines


def validate(
    content: dict[str, Any],
    model: type[Model],
    *,
    where: object,
    lines: dict[Place, int] | None = None,
    overrides: Sequence[str] = (),
) -> Model:
    """`content` as a `model`; raises UsageError naming the key (and its line, where `lines` knows it)."""
    content = _with_overrides(content, overrides)
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise _misuse(error, content, model, where, lines or {}) from None


def _note_lines(node: yaml.Node, place: Place, lines: dict[Place, int], where: object) -> None:
    lines.setdefault(place, node.start_mark.line + 1)
    if isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            _note_lines(item, (*place, index), lines, where)
    elif isinstance(node, yaml.MappingNode):
        first: dict[str, int] = {}
        for key, value in node.value:
            number = key.start_mark.line + 1
            if not isinstance(key, yaml.ScalarNode) or key.tag == "tag:yaml.org,2002:merge":
                raise UsageError("key is not a plain word", where=f"{where}, line {number}")
            if key.value in first:
                why = f"first in line {first[key.value]}"
                raise UsageError(f"key '{key.value}' is given twice", where=f"{where}, line {number}", why=why, remedy="keep one")
            first[key.value] = number
            lines[(*place, key.value)] = number
            _note_lines(value, (*place, key.value), lines, where)


def _with_overrides(content: dict[str, Any], overrides: Iterable[str]) -> dict[str, Any]:
    for override in overrides:
        key, equals, text = override.partition("=")
        if not equals or not key.strip():
            raise UsageError("is not an override", where=override, remedy="write it as --set key=value")
        value = plain_yaml.parse(text, where=f"--set {override}")
        content = _set(content, key.strip().split("."), value, override)
    return content


def _set(content: Any, keys: list[str], value: Any, override: str) -> Any:
    """A copy of nested mappings and lists with one value replaced; the keys of a list are indices."""
    if not keys:
        return value
    key, *rest = keys
    if isinstance(content, list):
        if not key.isdecimal() or int(key) >= len(content):
            last = len(content) - 1
            remedy = f"items are numbered from 0 to {last}" if content else "write the whole list"
            why = f"'{key}' in a list of {last + 1}"
            raise UsageError("there is no such item", where=f"--set {override}", why=why, remedy=remedy)
        return [_set(item, rest, value, override) if index == int(key) else item for index, item in enumerate(content)]
    if not isinstance(content, dict):
        raise UsageError("has no keys inside", where=f"--set {override}", why=f"'{key}' does not exist there")
    inner = content.get(key)
    return {**content, key: _set({} if inner is None else inner, rest, value, override)}


def _misuse(error: ValidationError, content: Any, model: type[BaseModel], where: object, lines: dict[Place, int]) -> UsageError:
    problems = error.errors(include_url=False)
    problem = min(problems, key=lambda p: p["type"] != "extra_forbidden")  # a misspelt key explains a missing one
    place, models = _resolve(problem["loc"], content, [model])
    line = next((lines[place[:n]] for n in range(len(place), 0, -1) if place[:n] in lines), None)
    location = f"{where}, line {line}" if line else str(where)
    key = ".".join(str(part) for part in place)
    if problem["type"] == "extra_forbidden":
        valid = [name for m in models for name in m.model_fields]
        return UsageError(f"unknown key '{key}'", where=location, remedy=nearest(str(place[-1]), valid))
    if problem["type"] == "missing":
        missing = ".".join(str(part) for part in (*place, problem["loc"][-1]))
        return UsageError(f"key '{missing}' is missing", where=location, remedy=_describe(models, str(problem["loc"][-1])))
    words = problem["msg"].removeprefix("Value error, ")
    more = f"; {len(problems) - 1} more after it" if len(problems) > 1 else ""
    shown = problem["type"] != "value_error" and not isinstance(problem["input"], dict | list)
    given = f"given: {problem['input']!r}" if shown else ""
    what = f"key '{key}': {words}" if key else words
    return UsageError(what, where=location, why=f"{given}{more}".removeprefix("; "))


def _resolve(location: Place, content: Any, models: list[type[BaseModel]]) -> tuple[Place, list[type[BaseModel]]]:
    """Place in the file of pydantic's location, which includes the tags of unions, and the schemas that apply there.

    For an unknown key these are the schemas of its mapping; a missing key is not part of the place.
    """
    place: Place = ()
    for part in location:
        if isinstance(content, list):
            content = dict(enumerate(content))
        if isinstance(content, dict) and part in content:
            content = content[part]
            place = (*place, part)
            fields = [m.model_fields[part] for m in models if part in m.model_fields]
            inner = [m for field in fields for m in _models_in(field.annotation)]
            models = inner or models
        else:  # the tag of a union, or the missing key itself
            models = [m for m in models if part in _tags(m)] or models
    return place, models


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models_in(inner)


def _tags(model: type[BaseModel]) -> set[Any]:
    return {value for field in model.model_fields.values() for value in get_args(field.annotation)}


def _describe(models: list[type[BaseModel]], name: str) -> str:
    for model in models:
        if name in model.model_fields and model.model_fields[name].description:
            return f"it is the {model.model_fields[name].description}"
    return "add it"
