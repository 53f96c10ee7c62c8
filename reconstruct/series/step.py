"""A step of an object: one command as a person would type it, in a process of its own, with a log and a result.

OUT/OBJECT/steps/STEP.json    what was typed, how long it took, what it printed as JSON; it is there once the step is done
OUT/OBJECT/steps/STEP.log     what its processes wrote to their terminals
"""

import json
import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

from koala3d.datasets.core import files
from koala3d.datasets.core.console import hint
from koala3d.datasets.core.errors import DatasetError, KoalaError
from koala3d.reconstruct.experiments.job_log import last_line
from koala3d.reconstruct.experiments.waiting import Needs, end_with

FORMAT, VERSION = "koala-series-step", 1
STEPS = "steps"
RUN = "run.json"
"""The file that makes a folder a run: `reconstruct.run` needs JAX, and this module runs in processes that need none."""


@dataclass(frozen=True)
class Step:
    """One command for one object."""

    place: Path  # folder of the object
    kind: str  # name of the step
    words: tuple[str, ...]  # the command, paths relative to `folder`
    folder: Path  # where it runs
    out: Path | None = None  # what it writes; None: nothing of its own
    tolerated: bool = False  # whether exit code 1 with a result, as of a check with findings, is no failure
    needs: Needs = field(default_factory=Needs)
    left_s: float = 0.0

    @property
    def name(self) -> str:
        """OBJECT/STEP."""
        return f"{self.place.name}/{self.kind}"

    @property
    def result(self) -> Path:
        """File with the result."""
        return self.place / STEPS / f"{self.kind}.json"

    @property
    def log(self) -> Path:
        """File with what was written to the terminals."""
        return self.result.with_suffix(".log")

    @property
    def done(self) -> bool:
        """Whether there is a result."""
        return self.result.is_file()

    @property
    def command(self) -> str:
        """What a person would type in `folder`."""
        return shlex.join(self.words)

    def read(self) -> dict[str, Any]:
        """The result: `command`, `seconds`, `output`. Raises DatasetError: it is damaged."""
        return _read(self.result)

    def attempt(self) -> str:
        """Run unless there is a result; the error, or "". What a killed process left is resumed, or made again."""
        if self.done:
            return ""
        words, began = [*self.words, *self._resumed(), "--json"], time.time()
        hint(f"$ {shlex.join(words)}")
        program = [sys.executable, "-m", f"koala3d.{words[0]}.cli", *words[1:]]
        ending = partial(end_with, os.getpid())
        with subprocess.Popen(program, stdout=subprocess.PIPE, cwd=self.folder, preexec_fn=ending) as process:
            try:
                printed = process.communicate()[0].decode(errors="replace")
            except KeyboardInterrupt:
                process.wait()  # Ctrl-C reached it, too, and a training saves what it has
                raise
        hint(printed.rstrip())
        output = _json(printed)
        if problem := self._problem(process.returncode, output):
            return problem
        content = {"command": self.command, "seconds": round(time.time() - began, 2), "output": output}
        files.write_json(self.result, {"format": FORMAT, "version": VERSION, **content})
        return ""

    def _resumed(self) -> Sequence[str]:
        """Words that resume what was begun; anything else that is there and has no result is removed."""
        if self.kind == "train" and self.out is not None and (self.out / RUN).is_file():
            return ["--resume"]
        if self.out is not None and self.out.is_dir():
            shutil.rmtree(self.out)
        elif self.out is not None:
            self.out.unlink(missing_ok=True)
        return []

    def _problem(self, code: int, output: dict[str, Any] | None) -> str:
        """The error of a command that has ended, or ""."""
        if output is None:
            ended = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
            return (
                f"'{' '.join(self.words[:2])}' {ended}; {self.log} ends with: {last_line(self.log.read_text(errors='replace'))}"
            )
        if "error" in output and "exit_code" in output:
            return str(output["error"])
        if code == 0 or self.tolerated:
            return ""
        errors = [one for one in output.get("findings", ()) if one.get("level") == "error"]
        if not errors:
            return f"'{' '.join(self.words[:2])}' ended with exit code {code}; see {self.log}"
        first = errors[0]
        told = KoalaError(first["what"], **{key: first.get(key, "") for key in ("where", "why", "remedy")})
        return f"'{' '.join(self.words[:2])}' finds {len(errors)} error{'s' if len(errors) > 1 else ''}: {told}"


@cache
def _read(result: Path) -> dict[str, Any]:
    """The content of a result, which never changes once it is there."""
    content = files.read_json(result, kind=FORMAT, version=VERSION)
    if not isinstance(content.get("output"), dict) or not isinstance(content.get("seconds"), int | float):
        raise DatasetError("result of a step is not complete", where=result, remedy="remove it, and run the series again")
    return content


def _json(printed: str) -> dict[str, Any] | None:
    """The JSON object that a command has printed, or None."""
    for line in reversed(printed.splitlines()):
        if line.startswith("{"):
            try:
                return dict(json.loads(line))
            except (ValueError, TypeError):
                return None
    return None
