"""Answers the questions of `capture calibrate`: one line of JSON in, one out, until the input ends."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from koala3d.calib.advice.adviser import Adviser, Wanted
from koala3d.calib.advice.growing import GrowingSession
from koala3d.calib.advice.hints import hints
from koala3d.calib.calibrate import STATED
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets.advice import Answer, Figures, Question
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core.errors import KoalaError

CALIBRATION = "calibration.json"  # in the recording's folder


class Recorded:
    """Answers about a recording that is being made."""

    def __init__(
        self, path: Path, until: Figures, accuracy: Accuracy = STATED, given: Calibration | None = None, lens: str = "auto"
    ) -> None:
        self.path, self.source = Path(path), GrowingSession(Path(path))
        self._options = {"until": until, "accuracy": accuracy, "given": given, "lens": lens}
        self.adviser: Adviser | None = None  # from the first view on, which tells how the camera is mounted

    def __call__(self, question: Question) -> Answer:
        """The answer, from all views that are on the disk by now."""
        session = self.source.session()
        if session is None:
            return Answer()
        if self.adviser is None:
            self.adviser = Adviser(Wanted(mount=self.source.mount(), **self._options))
        answer = replace(answered(self.adviser, session, question), seen=self.source.newest_seen)
        if question.finish and self.adviser.solution is not None:
            self.adviser.calibration().save(self.path / CALIBRATION)
            answer = replace(answer, calibration=str(self.path / CALIBRATION))
        return answer


def answered(adviser: Adviser, session: TargetSession, question: Question) -> Answer:
    """What an adviser says of all views so far."""
    adviser.update(session, anew=question.anew)
    known, figures, until = adviser.known, adviser.figures, adviser.wanted.until
    tell = question.finish and known is not None and figures is not None
    return Answer(
        views=len(session.observations),
        seen=True,
        board=None if known is None else known.state.stand_from_board,
        figures=figures,
        refused=adviser.refused,
        expected=adviser.expected(question.candidates),
        hints=hints(known, session.base_from_flange, figures, until) if tell and known and figures else [],
    )


def serve(lines: Iterable[str], write: Callable[[str], None], answer: Callable[[Question], Answer]) -> None:
    """Answer line after line. What Koala refuses is an answer with `error`."""
    for line in lines:
        try:
            found = answer(Question.from_line(line))
        except KoalaError as error:
            found = Answer(error=str(error))
        write(found.to_line())
