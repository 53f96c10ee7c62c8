"""Results as lines of a CSV file, each on the disk before the next trial begins."""

import csv
import io
import os
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from datasets.core.errors import DatasetError
from reconstruct.bench.suite import Trial
from reconstruct.output import metrics
from reconstruct.output.mesh import surface_distance

KEY = tuple(field.name for field in fields(Trial))
FIGURES = (*metrics.DEFINITIONS, *surface_distance.DEFINITIONS)
"""Errors, as `reconstruct eval` has them; `seconds` is the time per test view."""
WORK = ("steps", "rays_per_s", "samples_per_s", "training_s", "preparation_s", "compilation_s", "cold", "peak_memory_mb",
        "cores_used", "skipped_steps", "occupied")  # fmt: skip
"""What it took. `cold`: 1 where programs had to be compiled, 0 where they were on the disk."""
CONTEXT = ("width", "height", "train_views", "load", "machine", "cores", "memory_gb", "device", "python", "jax", "jaxlib", "numpy",
           "commit", "when")  # fmt: skip
"""Where and when it was measured. `load`: processes that wanted to run when it began."""
COLUMNS = (*KEY, "status", *FIGURES, *WORK, *CONTEXT)
DONE = "done"
DEFINITIONS = {
    "rays_per_s": "rays drawn per second of training, those that meet nothing included",
    "samples_per_s": "entries of the list of samples per second of training, filled or not",
    "training_s": "seconds in training steps: the budget",
    "preparation_s": "seconds to read the pictures and probe the scene",
    "compilation_s": "seconds to compile the training step, or to load it",
    "peak_memory_mb": "largest resident set of the process, evaluation included",
    "cores_used": "processor time over time on the clock, while training",
}
Row = dict[str, Any]


class Records:
    """The lines of one file."""

    def __init__(self, path: Path) -> None:
        """Records at `path`, which need not exist yet."""
        self.path = path

    def rows(self) -> list[Row]:
        """All whole lines; numbers as numbers, what is not known as None. A line cut off by a kill does not count.

        Raises:
            DatasetError: the file is of another kind.
        """
        text = self.path.read_text(encoding="utf-8") if self.path.is_file() else ""
        whole = text[: text.rfind("\n") + 1]
        reader = csv.DictReader(io.StringIO(whole))
        if whole and tuple(reader.fieldnames or ()) != COLUMNS:
            missing = set(COLUMNS) ^ set(reader.fieldnames or ())
            raise DatasetError("holds other columns than this version writes", where=self.path, why=f"{sorted(missing)[:4]}",
                               remedy="choose another --out")  # fmt: skip
        return [{name: _number(value) if name not in _TEXT else value for name, value in row.items()} for row in reader]

    def done(self) -> set[tuple[str, ...]]:
        """Keys of the trials that were finished."""
        return {key_of(row) for row in self.rows() if row["status"] == DONE}

    def append(self, row: Mapping[str, Any]) -> None:
        """Add a line and bring it to the disk."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        text = self.path.read_bytes() if self.path.is_file() else b""
        buffer = io.StringIO()
        writer = csv.DictWriter(buffer, COLUMNS, restval="", lineterminator="\n")
        if b"\n" not in text:
            writer.writeheader()
        writer.writerow({name: "" if row.get(name) is None else row[name] for name in COLUMNS})
        with open(self.path, "r+b" if text else "wb") as file:
            file.seek(text.rfind(b"\n") + 1)  # over a line that was cut off
            file.truncate()
            file.write(buffer.getvalue().encode())
            file.flush()
            os.fsync(file.fileno())


_TEXT = frozenset(
    {"kind", "scene", "model", "preset", "status", "machine", "device", "python", "jax", "jaxlib", "numpy", "commit", "when"}
)


def _number(text: str | None) -> float | None:
    try:
        return float(text) if text else None
    except ValueError:
        return None


def key_of(row: Mapping[str, Any]) -> tuple[str, ...]:
    """The `Trial.key` that a row belongs to."""
    return tuple(f"{row[name]:g}" if isinstance(row[name], float) else str(row[name]) for name in KEY)


def latest(rows: Iterable[Row]) -> list[Row]:
    """The finished rows, of each trial the last."""
    return list({key_of(row): row for row in rows if row["status"] == DONE}.values())
