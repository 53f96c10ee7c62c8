"""Crash consistency: after a kill or a power cut at any system call, repeating leads to what an undisturbed run leaves."""

import os
import shutil
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import disk
import pytest
import strace
from artefacts import ARTEFACTS, Artefact, sources_of_scene

ROOT = Path(__file__).parents[3]
MOST = 50
"""Where an artefact has more distinct states, `make test` tries some, spread over all of them."""
SHARE = 10
REASON = strace.available()
pytestmark = pytest.mark.skipif(bool(REASON), reason=REASON)


@dataclass
class Recorded:
    """One undisturbed run: its artefact, its states, and its result."""

    name: str
    artefact: Artefact
    sources: Path
    folder: Path
    states: list[disk.State]
    """Distinct ones, in the order in which they occurred first."""
    prefixes: int
    expected: object

    def after(self, state: disk.State) -> Path:
        """The folder as a crash left it, where it was when it was written."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir()
        disk.restore(state.tree, self.folder)
        return self.folder


@pytest.fixture(scope="module", params=sorted(ARTEFACTS))
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    artefact, place = ARTEFACTS[request.param], tmp_path_factory.mktemp(request.param)
    sources, folder, marks = place / "sources", place / "folder", place / "marks"
    for path in (sources, folder, marks):
        path.mkdir()
    sources_of_scene(sources)
    program = str(Path(__file__).with_name("artefacts.py"))
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
    calls = strace.recorded([sys.executable, program, request.param, str(sources), str(folder), str(marks)], environment)
    distinct, prefixes, last = {}, 0, None
    for state in disk.states(calls, folder, marks):
        key = (disk.digest(state.tree), state.marks if state.variant == "dropped" else ())
        distinct.setdefault(key, state)
        prefixes = max(prefixes, state.prefix)
        last = state
    assert last is not None and last.variant == "killed"
    written = {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}
    assert disk.digest(last.tree) == disk.digest(written), "the premise: the model ends with what is on the disk"
    return Recorded(request.param, artefact, sources, folder, list(distinct.values()), prefixes, artefact.result(folder))


def recovery(run: Recorded, state: disk.State) -> str:
    """What is wrong after a crash; empty where repeating leads to the same result."""
    folder = run.after(state)
    try:
        run.artefact.repeat(run.sources, folder)
        result = run.artefact.result(folder)
    except BaseException as error:
        return f"{type(error).__name__}: {' '.join(str(error).split())[:160]}"
    return "" if result == run.expected else "another result"


def report(run: Recorded, tried: list[disk.State], wrong: list[tuple[disk.State, str]]) -> str:
    """How many prefixes were replayed, and what failed."""
    variants = Counter(state.variant.split()[0] for state, _ in wrong)
    examples = "; ".join(f"after {state.prefix} changes, {state.variant}: {words}" for state, words in wrong[:4])
    return (
        f"{run.name}: {run.prefixes} prefixes, {len(run.states)} distinct states, {len(tried)} tried, "
        f"{len(wrong)} wrong {dict(variants)} {examples}"
    )


def check_recovery(run: Recorded, tried: list[disk.State]) -> None:
    wrong = [(state, words) for state in tried if (words := recovery(run, state))]
    print(report(run, tried, wrong))
    assert not wrong, report(run, tried, wrong)


def sample(states: list[disk.State]) -> list[disk.State]:
    return states if len(states) <= MOST else states[:: len(states) // SHARE]


def by_kill(run: Recorded) -> list[disk.State]:
    return [state for state in run.states if state.variant == "killed"]


def by_power_cut(run: Recorded) -> list[disk.State]:
    return [state for state in run.states if state.variant != "killed"]


def test_repeating_after_a_kill_ends_with_the_same_result(run: Recorded) -> None:
    check_recovery(run, sample(by_kill(run)))


def test_repeating_after_a_power_cut_ends_with_the_same_result(run: Recorded) -> None:
    check_recovery(run, sample(by_power_cut(run)))


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_repeating_after_a_kill_at_every_prefix_ends_with_the_same_result(run: Recorded) -> None:
    check_recovery(run, by_kill(run))


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_repeating_after_a_power_cut_at_every_prefix_ends_with_the_same_result(run: Recorded) -> None:
    check_recovery(run, by_power_cut(run))


def test_what_was_reported_as_done_survives_a_power_cut(run: Recorded) -> None:
    tried = [state for state in run.states if state.variant == "dropped" and state.marks]
    wrong = []
    for state in tried:
        missing = set(state.marks) - run.artefact.kept(run.after(state))
        if missing:
            wrong.append((state, f"lost {', '.join(sorted(missing))}"))
    assert tried and not wrong, report(run, tried, wrong)
