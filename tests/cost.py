"""What the suite costs: core-seconds (user and system) of each test, added up by folder and printed after the run.

Each worker reads `resource` around a test: its own time, and that of the programs that it started and waited for. What no test
accounts for is the line `outside tests`: imports, collection, and pytest's own work. Nobody waits for most processes of Chromium
and of Ray: they are missing.
"""

import resource
from collections import defaultdict
from collections.abc import Generator, Mapping
from typing import Any

import pytest

KEY = "core_seconds"
DEPTH = 3
"""Folders are told apart down to this many names, `tests/` among them."""


def core_seconds() -> float:
    """User and system time of this process and of its ended children [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def by_folder(tests: Mapping[str, float]) -> dict[str, float]:
    """Core-seconds of folders, the dearest first, of those of tests by their node ids."""
    sums: dict[str, float] = defaultdict(float)
    for node, seconds in tests.items():
        *folders, _ = node.split("::")[0].split("/")
        sums["/".join(folders[:DEPTH])] += seconds
    return dict(sorted(sums.items(), key=lambda pair: -pair[1]))


class Cost:
    """Measures in the process that runs a test; collects in the process that prints."""

    def __init__(self) -> None:
        self.tests: dict[str, float] = {}
        self._workers = self._began = 0.0

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self) -> Generator[None, object, object]:
        self._began = core_seconds()
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        report = yield
        if report.when == "teardown":
            report.user_properties.append((KEY, core_seconds() - self._began))
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "teardown":
            self.tests[report.nodeid] = float(str(dict(report.user_properties)[KEY]))

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if (output := getattr(session.config, "workeroutput", None)) is not None:
            output[KEY] = core_seconds()

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """A worker of pytest-xdist ends."""
        self._workers += getattr(node, "workeroutput", {}).get(KEY, 0.0)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        own = resource.getrusage(resource.RUSAGE_SELF)
        total = self._workers + own.ru_utime + own.ru_stime if self._workers else core_seconds()
        folders = by_folder(self.tests)
        terminalreporter.section("core-seconds")
        for name, seconds in {**folders, "outside tests": total - sum(folders.values()), "total": total}.items():
            terminalreporter.write_line(f"{seconds:8.1f}  {name}")
