import json
from pathlib import Path

import numpy as np
import pytest

from calib.advice.serve import CALIBRATION, Recorded, serve
from calib.study.rehearsal import Rehearsed
from datasets.advice import Answer, Question
from datasets.calibration import Calibration
from datasets.recording import FRAMES, MANIFEST


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


def test_a_recording_is_read_as_it_grows(simulated_board: Path, tmp_path: Path):
    """A recording of eight rendered views, of which the adviser first sees two, then all."""
    growing = tmp_path / "growing"
    growing.mkdir()
    (growing / "images").symlink_to(simulated_board / "images")
    (growing / MANIFEST).write_text((simulated_board / MANIFEST).read_text())
    lines = (simulated_board / FRAMES).read_text().splitlines(keepends=True)
    answer = Recorded(growing, (0.05, 0.01))
    (growing / FRAMES).write_text("".join(lines[:2]))
    early = answer(Question())
    assert early.views == 2 and early.figures is None and early.board is not None and early.seen
    (growing / FRAMES).write_text("".join(lines))
    late = answer(Question(finish=True))
    assert late.views == len(lines) and late.figures is not None
    assert late.calibration == str(growing / CALIBRATION) and late.hints[-1].startswith("more views")
    truth = json.loads((simulated_board / "truth" / "poses.json").read_text())["flange_from_camera"]
    found = Calibration.load(growing / CALIBRATION).flange_from_camera
    assert found is not None
    assert 1e3 * np.linalg.norm(found.matrix[:3, 3] - np.array(truth)[:3, 3]) < late.figures[0]


@pytest.fixture(scope="module")
def simulated_board(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from capture.planning import plan
    from capture.recording.recorder import record
    from capture.rig.opening import open_rig
    from capture.trajectory import load_trajectory

    small = ["camera.binning=4", "camera.width=480", "camera.height=270", "views.0.count=8"]
    trajectory = load_trajectory("calibration", overrides=small)
    out = tmp_path_factory.mktemp("board") / "recording"
    with open_rig("sim", trajectory, scene="board", seed=0, time_scale=50.0) as rig:
        record(trajectory, rig, out, planned=plan(trajectory, rig.flange_from_camera))
    return out
