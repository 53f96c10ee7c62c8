"""Steps are real commands in processes of their own: done once, resumed or made again, and their errors in one line."""

import os
import shutil
import signal
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path

import pytest

from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.experiments import runner
from koala3d.reconstruct.series.step import Step
from tests.moments import as_soon_as, until


def outcome(step: Step) -> str:
    """The error of a step that runs in a process of its own, or ""."""
    (begun, ended) = runner.run_all([[step]])
    assert begun == (step, None) and ended[1] is not None
    return ended[1]


@pytest.fixture
def make(tmp_path: Path) -> Callable[..., Step]:
    """Factory of a step of the object `cup` from the words of its command."""

    def step(*words: object, kind: str = "check", **more: object) -> Step:
        return Step(tmp_path / "out" / "cup", kind, tuple(map(str, words)), tmp_path, **more)  # type: ignore[arg-type]

    return step


def test_a_step_is_done_once_and_leaves_what_it_printed(make: Callable[..., Step], ball_scene: tuple[Scene, Path]) -> None:
    step = make("datasets", "info", ball_scene[1])
    assert outcome(step) == ""
    result = step.read()
    assert result["command"] == f"datasets info {ball_scene[1]}" and result["seconds"] > 0 and result["output"]
    assert f"$ datasets info {ball_scene[1]} --json\n" in step.log.read_text()
    before = step.result.stat().st_mtime_ns
    assert step.attempt() == "" and step.result.stat().st_mtime_ns == before


def test_what_a_kill_left_is_made_again(make: Callable[..., Step], ball_scene: tuple[Scene, Path], tmp_path: Path) -> None:
    out = tmp_path / "out" / "cup" / "llff"
    out.mkdir(parents=True)
    (out / "half").write_text("")
    step = make("datasets", "export", ball_scene[1], "--format", "llff", "--out", out, out=out)
    assert outcome(step) == ""
    assert not (out / "half").exists() and (out / "poses_bounds.npy").is_file()


def test_an_error_of_the_command_is_the_error_of_the_step(make: Callable[..., Step], tmp_path: Path) -> None:
    problem = outcome(make("datasets", "info", tmp_path / "nowhere"))
    assert str(tmp_path / "nowhere") in problem and "\n" not in problem and not make("datasets").done


def test_findings_of_a_check_fail_unless_they_are_tolerated(
    make: Callable[..., Step], ball_scene: tuple[Scene, Path], tmp_path: Path
) -> None:
    shutil.copytree(ball_scene[1], tmp_path / "scene")
    next((tmp_path / "scene" / "images").iterdir()).unlink()
    words = ("datasets", "check", "scene", "--quick")
    problem = outcome(make(*words))
    assert problem.startswith("'datasets check' finds 1 error: ") and ".png" in problem and not make(*words).done
    problem = outcome(make(*words, tolerated=True))
    assert problem == "" and make(*words).read()["output"]["errors"] == 1


def child_of(step: Step) -> list[int]:
    """Processes that run the command of a step."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            words = (place / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if step.words[-1].encode() in words:
            found.append(int(place.name))
    return found


def test_a_killed_command_is_named_with_its_signal(make: Callable[..., Step], ball_scene: tuple[Scene, Path]) -> None:
    step = make("datasets", "view", ball_scene[1], "--quick", "--port", "0", "--data-root", "/tmp/series-killed")
    kill = lambda: [os.kill(process, signal.SIGKILL) for process in child_of(step)]  # noqa: E731
    with as_soon_as(lambda: child_of(step), kill, "the command"):
        problem = outcome(step)
    assert problem.startswith("'datasets view' was killed by signal 9; ") and not step.done


def test_a_damaged_result_is_named(make: Callable[..., Step]) -> None:
    step = make("datasets", "info", "scene")
    step.result.parent.mkdir(parents=True)
    step.result.write_text('{"format": "koala-series-step", "version": 1, "command": "x"}')
    with pytest.raises(DatasetError, match=r"check\.json: result of a step is not complete; remove it"):
        step.read()


def test_the_command_ends_with_the_process_that_waits_for_it(make: Callable[..., Step], ball_scene: tuple[Scene, Path]) -> None:
    """As when a worker of a cluster is killed: another one takes over."""
    step = make("datasets", "view", ball_scene[1], "--quick", "--port", "0", "--data-root", "/tmp/series-orphan")
    runner.prepare(step)
    worker = get_context("spawn").Process(target=runner.attempt, args=(step,))
    worker.start()
    until(lambda: child_of(step), "the command")
    worker.kill()
    until(lambda: not child_of(step), "the end of the command")
    worker.join()
