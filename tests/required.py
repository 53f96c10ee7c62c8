"""Skips that are failures: with KOALA_REQUIRE=all whatever a test asks for has to be on the machine (`make tools`).

What no package manager installs may still be absent: a connected arm or camera (marked `hardware`, and not selected), real data
beside the checkout (`real_data`), and the environments of nerfstudio and NerfBaselines.
"""

import os
from collections.abc import Generator
from typing import TypeVar

import pytest

ALL_REQUIRED = os.environ.get("KOALA_REQUIRE") == "all"
EXCEPTIONS = (
    "real data set ",
    "KOALA_NERFSTUDIO is not set",
    "KOALA_NERFBASELINES is not set",
    "a Basler camera is connected",
    "a RealSense camera is connected",
)
"""How the reasons begin of skips that no package would prevent."""
Report = TypeVar("Report", pytest.TestReport, pytest.CollectReport)


class Required:
    """Turns each skip into a failure that repeats its reason."""

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        return failed_if_skipped((yield))

    @pytest.hookimpl(wrapper=True)
    def pytest_make_collect_report(self) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
        return failed_if_skipped((yield))


def failed_if_skipped(report: Report) -> Report:
    """The report itself, a failure if it was a skip for want of something that can be installed."""
    if report.skipped and not hasattr(report, "wasxfail") and isinstance(report.longrepr, tuple):
        path, line, reason = report.longrepr
        if not reason.removeprefix("Skipped: ").startswith(EXCEPTIONS):
            report.outcome = "failed"
            report.longrepr = f"{path}:{line}: skipped, but KOALA_REQUIRE=all: {reason.removeprefix('Skipped: ')}"
    return report
