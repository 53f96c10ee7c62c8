"""What the suite says of itself: skips that are failures, and what tests cost."""

import pytest

from tests.cost import by_folder
from tests.required import failed_if_skipped


def skipped(reason: str) -> pytest.TestReport:
    where = ("tests/view/test_pages.py", 7, "test_page")
    return pytest.TestReport(
        "tests/view/test_pages.py::test_page", where, {}, "skipped", (*where[:2], f"Skipped: {reason}"), "call"
    )


def test_a_skip_is_a_failure_that_says_what_is_missing() -> None:
    report = failed_if_skipped(skipped("there is no Chromium on this computer: make tools"))
    assert report.failed and "tests/view/test_pages.py:7" in str(report.longrepr) and "no Chromium" in str(report.longrepr)


@pytest.mark.parametrize(
    "reason", ["real data set fox is absent: /nowhere does not exist", "KOALA_NERFSTUDIO is not set: name it"]
)
def test_what_no_package_brings_may_be_absent(reason: str) -> None:
    assert failed_if_skipped(skipped(reason)).skipped


def test_an_expected_failure_is_no_skip() -> None:
    report = skipped("reason: known")
    report.wasxfail = "known"
    assert failed_if_skipped(report).skipped


def test_costs_are_added_by_folder() -> None:
    tests = {"tests/a/b/test_c.py::one": 1.0, "tests/a/b/d/test_e.py::two[3]": 2.0, "tests/test_f.py::three": 0.5}
    assert by_folder(tests) == {"tests/a/b": 3.0, "tests": 0.5}
