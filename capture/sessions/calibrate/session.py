"""One session of `capture calibrate`, from the rig's opening to the calibration, and what it shows."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.recording.growing import GrowingRecording
from koala3d.capture.rig.rig import Rig
from koala3d.capture.sessions.calibrate import candidates, loop
from koala3d.capture.sessions.calibrate.adviser import Adviser
from koala3d.capture.sessions.calibrate.loop import AccuracyGoal, CalibrationOutcome
from koala3d.capture.sessions.preview import show_reach
from koala3d.capture.sessions.start import SessionOptions
from koala3d.datasets.advice import Answer, Figures, Question
from koala3d.datasets.core import console
from koala3d.datasets.core.errors import UsageError

BAR = 24  # characters of the longer bar


class AdvisedRecording(GrowingRecording):
    """A rig, its recording, and the adviser who reads it; implements `capture.sessions.calibrate.loop.BoardViewTaker`."""

    def __init__(self, trajectory: Trajectory, rig: Rig, out: Path, adviser: Adviser) -> None:
        super().__init__(trajectory, rig, out, "capture calibrate")
        self.adviser = adviser

    def ask(self, question: Question) -> Answer:
        """Ask the adviser, who reads every view on the disk."""
        return self.adviser.ask(question)


def run(
    trajectory: Trajectory,
    out: Path,
    goal: AccuracyGoal,
    options: SessionOptions,
    arm: list[str],
    *,
    show: Callable[[int, Answer], None],
) -> CalibrationOutcome:
    """Record a session and write its calibration; the outcome has the last answer, with hints.

    Args:
        arm: options of `calib advise`: the arm's accuracy, the lens.
        show: called with the number of views and the answer after each view.

    Raises UsageError: `out` holds something else. CaptureError: an error of the rig; the arm stands still, `out` can be resumed.
    """
    from koala3d.capture.rig.naming import scene_for

    if trajectory.turns:
        remedy = "calibrate with a board that stands still, then record calibration_turntable for 'calib turntable'"
        raise UsageError("a session that chooses its views turns no turntable", where=trajectory.name, remedy=remedy)
    options = replace(options, scene=scene_for(options.rig, options.scene, trajectory))
    until = ["--until", *map(str, goal.until)]
    with Adviser(str(out), [*arm, *until]) as adviser, options.opened(trajectory, out) as rig:
        recording = AdvisedRecording(trajectory, rig, out, adviser)
        show_reach(recording, candidates.preview(trajectory, recording.obstacles, options.seed))
        if options.resume:
            recording.resume()
        outcome = loop.run(trajectory, rig.carrier, recording, goal, seed=options.seed, show=show)
        return CalibrationOutcome(outcome.reason, adviser.ask(Question(finish=True)) if outcome.answer.views else outcome.answer)


def show(views: int, answer: Answer, until: Figures) -> None:
    """Print the state after a view: both errors, with a bar each that vanishes as the wanted error is reached."""
    if not views:
        return
    name = f"view {views - 1:03d}"
    if not answer.seen:
        console.hint(f"{name}: the board is not in the picture")
    elif answer.figures is None:
        console.hint(f"{name}: too few views yet ({answer.views} with the board)")
    else:
        mm, deg = answer.figures
        console.hint(f"{name}: {mm:8.4f} mm {bar(mm / until[0])}  {deg:8.5f} deg {bar(deg / until[1])}")


def bar(ratio: float) -> str:
    """A bar of BAR characters: full at 30 times the wanted error, empty where that is reached."""
    filled = round(BAR * min(max(math.log(ratio) / math.log(30), 0.0), 1.0))
    return ("#" * filled).ljust(BAR, ".")


def describe(out: Path, outcome: CalibrationOutcome, goal: AccuracyGoal) -> str:
    """The outcome in a few lines."""
    answer = outcome.answer
    lines = [f"ended: {loop.REASONS[outcome.reason]}"]
    if answer.figures is None:
        lines.append(f"no calibration: {answer.refused or 'no view shows the board'}; the views are kept in {out}")
        lines += [f"what would help: {words}" for words in advice(outcome)]
        return "\n".join(lines)
    mm, deg = answer.figures
    lines.append(f"{answer.views} views; with 95 % certainty the errors are below {mm:.4f} mm and {deg:.5f} deg")
    if outcome.reason != loop.REACHED:
        lines.append(f"wanted: {goal.until[0]:g} mm and {goal.until[1]:g} deg")
        lines += [f"what would help: {words}" for words in advice(outcome)]
    return "\n".join([*lines, f"written to {answer.calibration}"])


def advice(outcome: CalibrationOutcome) -> list[str]:
    """What would help, by the reason for the end."""
    if outcome.reason == loop.NOT_FOUND:
        return ["light and focus in which the board is seen, its description in 'target', or views that look elsewhere"]
    if outcome.reason in (loop.HIDDEN, loop.NO_PATH, loop.LOST_BOARD):
        return ["more room for the arm (views or safety.workspace of the trajectory), or a board in the middle of it"]
    return outcome.answer.hints


def facts(out: Path, outcome: CalibrationOutcome, goal: AccuracyGoal) -> dict[str, Any]:
    """The outcome for a program."""
    answer = outcome.answer
    figures = answer.figures or (None, None)
    return {
        "recording": str(out),
        "calibration": answer.calibration or None,
        "reason": outcome.reason,
        "views": answer.views,
        "error_mm_95": figures[0],
        "error_deg_95": figures[1],
        "wanted": goal.until,
        "what_would_help": [] if outcome.reason == loop.REACHED else advice(outcome),
    }
