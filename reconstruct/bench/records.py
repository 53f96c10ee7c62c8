"""Results as lines of a CSV file; each is on disk before the next trial starts."""

import csv
import io
import os
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, NoReturn

from koala3d.datasets.core.errors import DatasetError
from koala3d.reconstruct.bench.suite import Trial
from koala3d.reconstruct.output import metrics
from koala3d.reconstruct.output.mesh import surface_distance

KEY = tuple(field.name for field in fields(Trial))
METRICS = (*metrics.DEFINITIONS, *surface_distance.DEFINITIONS)
"""Metrics of `reconstruct eval`; `seconds` is the time per test view."""
TIMES = ("steps", "rays_per_s", "samples_per_s", "training_s", "preparation_s", "compilation_s", "cold")
WORK = (*TIMES, "peak_memory_mb", "cores_used", "skipped_steps", "occupied")
"""Time, memory and work. `cold`: 1 if programs were compiled, 0 if they were loaded from the cache."""
VERSIONS = ("python", "jax", "jaxlib", "numpy", "commit", "when")
CONTEXT = ("width", "height", "train_views", "load", "machine", "cores", "memory_gb", "device", *VERSIONS)
"""Where and when it was measured. `load`: load average at the start."""
COLUMNS = (*KEY, "status", *METRICS, *WORK, *CONTEXT)
DONE = "done"
DEFINITIONS = {
    "rays_per_s": "rays drawn per second of training, including those that miss the object",
    "samples_per_s": "samples per second of training, including unused capacity",
    "training_s": "seconds spent in training steps: the budget",
    "preparation_s": "seconds to read the images and analyse the scene",
    "compilation_s": "seconds to compile the training step, or to load it",
    "peak_memory_mb": "largest resident set of the process, including evaluation",
    "cores_used": "CPU time per elapsed time while training",
}
Row = dict[str, Any]


class Records:
    """The lines of one file."""

    def __init__(self, path: Path) -> None:
        """Records at `path`, which need not exist yet."""
        self.path = path

    def rows(self) -> list[Row]:
        """All complete lines, unknown values as None. A last line without its end, left by a kill, is ignored.

        Files of earlier versions may lack metrics. Raises DatasetError: other columns differ.
        """
        text = self.path.read_text(encoding="utf-8") if self.path.is_file() else ""
        whole = text[: text.rfind("\n") + 1]
        reader = csv.DictReader(io.StringIO(whole))
        columns = tuple(reader.fieldnames or ())
        if whole and columns != tuple(name for name in COLUMNS if name in columns or name not in METRICS):
            self._refuse(columns)
        unknown = dict.fromkeys(name for name in METRICS if name not in columns)
        read = [{name: _number(value) if name not in _TEXT else value for name, value in row.items()} for row in reader]
        return [row | unknown for row in read]

    def _refuse(self, columns: Iterable[str]) -> NoReturn:
        why, advice = f"{sorted(set(COLUMNS) ^ set(columns))[:4]}", "choose another --out"
        raise DatasetError("columns differ from this version's", where=self.path, why=why, remedy=advice)

    def done(self) -> set[tuple[str, ...]]:
        """Keys of the finished trials."""
        return {key_of(row) for row in self.rows() if row["status"] == DONE}

    def append(self, row: Mapping[str, Any]) -> None:
        """Append a line and flush it to disk. Raises DatasetError: the columns differ."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        text = self.path.read_bytes() if self.path.is_file() else b""
        if b"\n" in text and (columns := text[: text.index(b"\n")].decode().split(",")) != list(COLUMNS):
            self._refuse(columns)
        buffer = io.StringIO()
        writer = csv.DictWriter(buffer, COLUMNS, restval="", lineterminator="\n")
        if b"\n" not in text:
            writer.writeheader()
        writer.writerow({name: "" if row.get(name) is None else row[name] for name in COLUMNS})
        with open(self.path, "r+b" if text else "wb") as file:
            file.seek(text.rfind(b"\n") + 1)  # overwrites an incomplete line
            file.truncate()
            file.write(buffer.getvalue().encode())
            file.flush()
            os.fsync(file.fileno())


_TEXT = frozenset({"kind", "scene", "model", "preset", "status", "machine", "device", *VERSIONS})


def _number(text: str | None) -> float | None:
    try:
        return float(text) if text else None
    except ValueError:
        return None


def key_of(row: Mapping[str, Any]) -> tuple[str, ...]:
    """The `Trial.key` that a row belongs to."""
    return tuple(f"{row[name]:g}" if isinstance(row[name], float) else str(row[name]) for name in KEY)


def latest(rows: Iterable[Row]) -> list[Row]:
    """The last finished row of each trial."""
    return list({key_of(row): row for row in rows if row["status"] == DONE}.values())
