"""Steps are counted by a clock, several at a time."""

from pathlib import Path

import pytest

pytest.importorskip("ray.cluster_utils", reason="Ray is absent: pip install 'koala-capture[sweep]'")

from koala3d.reconstruct.experiments.waiting import Needs
from tests.bench.series_scaling import Slept, counted


def steps(folder: Path, *seconds: float) -> list[Slept]:
    named = enumerate(seconds)
    return [Slept(folder / str(n), "train", ("reconstruct",), folder, needs=Needs(), left_s=s, seconds=s) for n, s in named]


@pytest.mark.parametrize(("workers", "ends"), [(1, [5, 8, 10, 11]), (2, [3, 5, 5, 6]), (8, [1, 2, 3, 5])])
def test_the_longest_go_first_and_workers_do_not_wait(workers: int, ends: list[float], tmp_path: Path) -> None:
    clock: list[float] = []
    told = list(counted(iter([steps(tmp_path, 1.0, 5.0, 3.0, 2.0)]), workers, clock))
    assert clock == pytest.approx(ends)
    assert sum(problem is None for _, problem in told) == sum(problem == "" for _, problem in told) == 4
    assert all(step.done and step.read()["seconds"] == step.seconds for step, _ in told)
