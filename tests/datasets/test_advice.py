import numpy as np
import pytest

from koala3d.datasets.advice import Answer, Question
from koala3d.datasets.core.errors import DatasetError


def test_questions_and_answers_survive_their_line():
    question = Question(candidates=np.stack([np.eye(4), 2 * np.eye(4)]), anew=True, rehearse=3)
    again = Question.from_line(question.to_line())
    np.testing.assert_array_equal(again.candidates, question.candidates)
    assert again.flown.shape == (0, 4, 4) and again.anew and again.rehearse == 3 and not again.finish
    answer = Answer(views=3, board=np.eye(4), figures=(0.1, 0.02), expected=[None, (0.05, 0.01)], truth=(0.01, 0.002))
    line = answer.to_line()
    assert line.count("\n") == 1
    other = Answer.from_line(line)
    np.testing.assert_array_equal(other.board, np.eye(4))
    assert other.figures == (0.1, 0.02) and other.expected == [None, (0.05, 0.01)] and other.truth == (0.01, 0.002)


@pytest.mark.parametrize("line", ["", "[]", "{", '{"candidates": [1, 2], "figures": [1]}', '{"else": 1}', "3"])
@pytest.mark.parametrize("kind", [Question, Answer])
def test_anything_else_is_refused(kind: type, line: str):
    with pytest.raises(DatasetError, match="no line of a question or an answer"):
        kind.from_line(line)
