"""YAML of strangers: plain values alone, of limited size and depth, and within a budget of nodes, each alias counted in full."""

from pathlib import Path
from typing import Any

import yaml

from koala3d.datasets.core import files
from koala3d.datasets.core.budgets import budget
from koala3d.datasets.core.errors import UsageError

MAX_BYTES = 2**22
MAX_DEPTH = 50
NODES = "KOALA_YAML_NODES"
MAX_NODES = 100_000  # budget of values and keys in one file; the environment variable `NODES` replaces it
_Parser: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def load(path: Path) -> Any:
    """Content of a YAML file. Raises UsageError where it is missing, too large or not plain YAML."""
    return parse(read_text(path), where=path)


def parse(text: str, *, where: object) -> Any:
    """Content of a YAML text; `where` names it in errors."""
    root = compose(text, where=where)
    return None if root is None else construct(root, where=where)


def read_text(path: Path) -> str:
    """Text of a YAML file of at most `MAX_BYTES`. Raises what `files.read_text` raises."""
    return files.read_text(path, MAX_BYTES, suffixes=(".yaml", ".yml"))


def compose(text: str, *, where: object) -> yaml.Node | None:
    """Nodes of a YAML text, which an alias may share; None of an empty text."""
    try:
        _count(text, where)
        return yaml.compose(text, Loader=_Parser)
    except yaml.MarkedYAMLError as error:
        line = f", line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise UsageError("is not valid YAML", where=f"{where}{line}", why=error.problem or "") from None
    except (yaml.YAMLError, ValueError) as error:
        raise UsageError("is not valid YAML", where=where, why=str(error)) from None


def construct(root: yaml.Node, *, where: object) -> Any:
    """The value of nodes."""
    constructor = yaml.SafeLoader("")
    try:
        return constructor.construct_document(root)
    except (yaml.YAMLError, ValueError, OverflowError, TypeError) as error:
        raise UsageError("is not valid YAML", where=where, why=str(error)) from None
    finally:
        constructor.dispose()


def _count(text: str, where: object) -> None:
    """Raise UsageError where a text is nested too deeply or holds more nodes than the budget, before any is kept."""
    total, most = 0, budget(NODES, MAX_NODES)
    anchors: dict[str, int] = {}
    """Number of nodes below each anchor that is complete."""
    opened: list[tuple[str | None, int]] = []
    """Anchor of each open list and mapping, and the total before it."""
    for event in yaml.parse(text, Loader=_Parser):
        line = f"{where}, line {event.start_mark.line + 1}"
        if isinstance(event, yaml.AliasEvent):
            if any(event.anchor == anchor for anchor, _ in opened):
                raise UsageError("alias refers to what it is part of", where=line, why=f"*{event.anchor}")
            total += anchors.get(event.anchor, 0)
        elif isinstance(event, yaml.CollectionStartEvent):
            opened.append((event.anchor, total))
            total += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = opened.pop()
            anchors |= {anchor: total - before} if anchor else {}
        elif isinstance(event, yaml.ScalarEvent):
            total += 1
            anchors |= {event.anchor: 1} if event.anchor else {}
        if len(opened) > MAX_DEPTH:
            raise UsageError("is nested too deeply", where=line, why=f"more than {MAX_DEPTH} levels")
        if total > most:
            why = f"with its aliases written out it exceeds the budget of {most} values"
            raise UsageError(
                "holds too many values", where=line, why=why, remedy=f"if you trust the file, set {NODES} to a larger number"
            )
