"""The adviser that `capture calibrate` asks: the program `calib advise`, which reads the recording and answers in JSON."""

import subprocess
import sys
import tempfile
from types import TracebackType
from typing import IO, Self

from koala3d.capture.drivers.errors import CaptureError
from koala3d.datasets.advice import Answer, Question


class AdviserError(CaptureError):
    """The adviser refused or has ended. The views taken so far are kept."""


class Adviser:
    """A running adviser. Use as a context manager; leaving ends it."""

    def __init__(self, recording: str, options: list[str]) -> None:
        self._command = [sys.executable, "-m", "koala3d.calib.cli", "advise", recording, *options]
        self._output: IO[bytes] | None = None
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Self:
        self._output = tempfile.TemporaryFile()
        pipe = subprocess.PIPE
        # its own session: Ctrl-C stops the arm, not the adviser
        self._process = subprocess.Popen(
            self._command, stdin=pipe, stdout=pipe, stderr=self._output, text=True, start_new_session=True
        )
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
        if self._output is not None:
            self._output.close()

    def ask(self, question: Question) -> Answer:
        """The answer to one question. Raises AdviserError where the adviser refuses or has ended."""
        assert self._process is not None and self._process.stdin is not None and self._process.stdout is not None  # entered
        try:
            self._process.stdin.write(question.to_line())
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            raise AdviserError("calib advise has ended", why=self._last_line(), remedy="continue with --resume")
        answer = Answer.from_line(line)
        if answer.error:
            raise AdviserError(answer.error)
        return answer

    def _last_line(self) -> str:
        assert self._output is not None  # entered
        self._output.seek(0)
        lines = self._output.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else "it printed nothing"
