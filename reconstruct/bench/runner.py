"""Runs a suite: each trial in a process, each result on the disk before the next begins.

OUT/records.csv     a line per trial: errors, work, machine, versions, commit
OUT/profiles.json   where the time of a step goes, by the trial's name
OUT/index.html      curves and tables

Shiny scenes are rendered once and kept in the cache folder.

A benchmark that was broken off goes on where it stopped, and trials can be added to it.
"""

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from datasets.core import files
from datasets.core.console import progress
from datasets.core.errors import KoalaError
from reconstruct.backend import cache_folder
from reconstruct.bench import context, suite, trial
from reconstruct.bench.records import DONE, Records
from reconstruct.bench.suite import Trial

RECORDS, PROFILES, SCENES = "records.csv", "profiles.json", "bench"
PROFILES_FORMAT, PROFILES_VERSION = "koala-bench-profiles", 1
PATIENCE_S = 900.0
"""A trial may take so long beyond its budget: reading, compiling, measuring."""


def run(trials: Sequence[Trial], out: Path, *, data: Path | None = None) -> dict[str, Any]:
    """Do what is not done yet.

    Args:
        out: folder of the benchmark; one that was broken off is gone on with.
        data: folder of the real scenes.

    Returns:
        How many trials were "done" now, had been "there", and "failed"; names of the scenes that are "absent".
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


def measure(one: Trial, place: Path, out: Path) -> dict[str, Any]:
    """The record of one trial, with the reason as its status where it failed."""
    row = {**vars(one), **context.describe()}
    with tempfile.TemporaryDirectory(prefix="koala-bench-") as folder:
        try:
            found = _in_a_process(one, place, Path(folder))
        except KoalaError as error:
            return {**row, "status": f"failed: {error.why}"}
    if "profile" in found:
        _keep_profile(one, found.pop("profile"), out)
    return {**row, "status": DONE, **found}


def _in_a_process(one: Trial, place: Path, folder: Path) -> dict[str, Any]:
    """What a trial's process found. Raises KoalaError where it ended otherwise, with its last words."""
    asked, answer = folder / "order.json", folder / "result.json"
    files.write_json(asked, trial.order(one, place.resolve(), folder / "run"))
    command = [sys.executable, "-m", "reconstruct.bench.trial", str(asked), str(answer)]
    with open(folder / "log.txt", "w+b") as log:
        try:
            code = subprocess.run(command, stdout=log, stderr=log, timeout=one.budget_s + PATIENCE_S, check=False).returncode
        except subprocess.TimeoutExpired:
            code = None
        log.seek(0)
        words = log.read().decode(errors="replace").strip().splitlines()
    if code != 0 or not answer.is_file():
        last = words[-1] if words else "no word"
        raise KoalaError("trial failed", where=one.name, why="took too long" if code is None else last[:200])
    shutil.rmtree(folder / "run", ignore_errors=True)
    found = files.read_json(answer, kind=trial.KIND, version=trial.VERSION)
    return {name: value for name, value in found.items() if name not in ("format", "version")}


def profiles(out: Path) -> dict[str, Any]:
    """Profiles by the trial's name; none where none were made."""
    path = out / PROFILES
    return files.read_json(path, kind=PROFILES_FORMAT, version=PROFILES_VERSION)["profiles"] if path.is_file() else {}


def _keep_profile(one: Trial, found: dict[str, Any], out: Path) -> None:
    content = {"format": PROFILES_FORMAT, "version": PROFILES_VERSION, "profiles": profiles(out) | {one.name: found}}
    files.write_json(out / PROFILES, content)
