"""Runs a suite: each trial in a process of its own; each result is on disk before the next trial starts.

OUT/records.csv     a line per trial: errors, work, machine, versions, commit
OUT/profiles.json   where the time of a step goes, by the trial's name
OUT/index.html      curves and tables

Shiny scenes are rendered once and kept in the cache folder. An interrupted benchmark is resumed; trials can be added to it.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from koala3d.datasets.core import files
from koala3d.datasets.core.console import progress
from koala3d.datasets.core.errors import KoalaError
from koala3d.reconstruct.backend import cache_folder
from koala3d.reconstruct.bench import context, suite, trial
from koala3d.reconstruct.bench.records import DONE, Records
from koala3d.reconstruct.bench.suite import Trial

RECORDS, PROFILES, SCENES = "records.csv", "profiles.json", "bench"
PROFILES_FORMAT, PROFILES_VERSION = "koala-bench-profiles", 1
PATIENCE_S = 900.0  # time limit of a trial beyond its budget: reading, compiling, evaluating


def run(trials: Sequence[Trial], out: Path, *, data: Path | None = None) -> dict[str, Any]:
    """Run the trials that are not finished yet.

    Args:
        data: folder of the real scenes.

    Returns:
        Numbers of trials "done" now, "there" before, and "failed"; names of the missing scenes ("absent").
    """
    records = Records(out / RECORDS)
    finished = records.done()
    todo = [one for one in trials if one.key not in finished]
    with progress("scenes", 1) as shown:
        places = suite.folders(todo, cache_folder() / SCENES, data, shown.note)
    absent = sorted({one.scene for one in todo} - set(places))
    todo = [one for one in todo if one.scene in places]
    failed = 0
    with progress("measuring", sum(one.budget_s for one in todo), "s") as shown:
        for one in todo:
            shown.note(one.name)
            row = measure(one, places[one.scene], out)
            failed += row["status"] != DONE
            records.append(row)
            shown.advance(one.budget_s)
    there = sum(one.key in finished for one in trials)
    return {"out": str(out), "done": len(todo) - failed, "there": there, "failed": failed, "absent": absent}


def measure(one: Trial, place: Path, out: Path, settings: Sequence[str] = (), **environment: str) -> dict[str, Any]:
    """The record of one trial; the status of a failed one has the reason.

    Args:
        settings: KEY=VALUE, on top of the preset's.
        environment: variables of the trial's process, beside those of this one.
    """
    row = {**vars(one), **context.describe()}
    with tempfile.TemporaryDirectory(prefix="koala-bench-") as folder:
        try:
            found = _in_a_process(one, place, Path(folder), settings, environment)
        except KoalaError as error:
            return {**row, "status": f"failed: {error.why}"}
    return {**row, "status": DONE, **found}


def _in_a_process(one: Trial, place: Path, folder: Path, settings: Sequence[str], environment: dict[str, str]) -> dict[str, Any]:
    """The result of a trial's process. Raises KoalaError with the last line of its log if it failed."""
    order = trial.order(one, place.resolve(), folder / "run", settings)
    found = answer_of("koala3d.reconstruct.bench.trial", order, folder, one.budget_s + PATIENCE_S, environment, name=one.name)
    shutil.rmtree(folder / "run", ignore_errors=True)
    return found


def answer_of(
    module: str, order: dict[str, Any], folder: Path, patience_s: float, environment: dict[str, str], *, name: str
) -> dict[str, Any]:
    """What a module makes of an order in a process of its own, `python -m MODULE ORDER.json RESULT.json`.

    Raises:
        KoalaError: it failed, with the last line of its log, or took longer than `patience_s` seconds.
    """
    asked, answer = folder / "order.json", folder / "result.json"
    files.write_json(asked, order)
    command, variables = [sys.executable, "-m", module, str(asked), str(answer)], {**os.environ, **environment}
    with open(folder / "log.txt", "w+b") as log:
        try:
            done = subprocess.run(command, stdout=log, stderr=log, timeout=patience_s, check=False, env=variables)
        except subprocess.TimeoutExpired:
            done = None
        log.seek(0)
        lines = log.read().decode(errors="replace").strip().splitlines()
    if done is None or done.returncode != 0 or not answer.is_file():
        last = lines[-1] if lines else "no output"
        raise KoalaError("trial failed", where=name, why="took too long" if done is None else last[:200])
    found = files.read_json(answer, kind=order["format"], version=order["version"])
    return {key: value for key, value in found.items() if key not in ("format", "version")}


def profiles(out: Path) -> dict[str, Any]:
    """Profiles by the trial's name; empty without any."""
    path = out / PROFILES
    return files.read_json(path, kind=PROFILES_FORMAT, version=PROFILES_VERSION)["profiles"] if path.is_file() else {}
