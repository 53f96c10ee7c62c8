import json
from pathlib import Path

import numpy as np

from koala3d.calib.advice.rehearsal import Rehearsed
from koala3d.calib.advice.serve import CALIBRATION, Recorded, serve
from koala3d.datasets import pose
from koala3d.datasets.advice import Answer, Question
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.recording import FRAMES, MANIFEST


def asked(answer, *lines: str) -> list[Answer]:
    found: list[str] = []
    serve(lines, found.append, answer)
    return [Answer.from_line(line) for line in found]


def test_what_is_refused_is_an_answer_and_the_next_question_is_answered(tmp_path: Path):
    wrong, unknown, right = asked(Recorded(tmp_path / "none", (0.05, 0.01)), "{", '{"what": 1}', Question().to_line())
    assert "no line of a question" in wrong.error and "unknown fields ['what']" in unknown.error
    assert right == Answer()


def test_a_rehearsal_has_to_begin():
    (found,) = asked(Rehearsed((0.05, 0.01)), Question(flown=np.eye(4)[None]).to_line())
    assert "no rehearsal has begun" in found.error


def test_a_rehearsal_is_repeatable():
    poses = np.stack([np.eye(4)] * 2)
    lines = [Question(rehearse=4).to_line(), Question(flown=poses).to_line()]
    first, again = asked(Rehearsed((0.05, 0.01)), *lines), asked(Rehearsed((0.05, 0.01)), *lines)
    assert first == again and not first[1].seen  # from the base's origin the board is not in the picture


def test_a_recording_is_read_as_it_grows(recorded_again, tmp_path: Path):
    """A recording of eight views, of which the adviser first sees two, then all."""
    whole, truth = recorded_again
    growing = tmp_path / "growing"
    growing.mkdir()
    (growing / "images").symlink_to(whole / "images")
    by_ruler = truth.flange_from_camera @ pose.from_rotation_vector([0.01, -0.02, 0.01], [3e-3, -2e-3, 4e-3])
    manifest = json.loads((whole / MANIFEST).read_text()) | {"nominal_flange_from_camera": by_ruler.tolist()}
    (growing / MANIFEST).write_text(json.dumps(manifest))
    lines = (whole / FRAMES).read_text().splitlines(keepends=True)
    answer = Recorded(growing, (0.05, 0.01))
    (growing / FRAMES).write_text("".join(lines[:2]))
    early = answer(Question())
    assert early.views == 2 and early.figures is None and early.board is not None and early.seen
    (growing / FRAMES).write_text("".join(lines))
    late = answer(Question(finish=True))
    assert late.views == len(lines) and late.figures is not None
    assert late.calibration == str(growing / CALIBRATION) and late.hints[-1].startswith("more views")
    found = Calibration.load(growing / CALIBRATION).flange_from_camera
    assert found is not None
    assert 1e3 * pose.difference(found.matrix, truth.flange_from_camera)[0] < late.figures[0]
