"""What was measured on a rig when it was accepted: the report that `tests/hardware` writes beside the rig file."""

from pathlib import Path

from koala3d.capture.doctor.lines import Line, ok, unknown, wrong
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import KoalaError

FORMAT, VERSION, SUFFIX = "koala-acceptance", 1, ".acceptance.json"
PASSED = "passed"
NAME = "acceptance"


def report_of(rig: Path) -> Path:
    """The report of a rig file: RIG.acceptance.json beside RIG.yaml."""
    return rig.with_name(f"{rig.stem}{SUFFIX}")


def check(rig: Path) -> Line:
    """The line about the report of a rig file."""
    path = report_of(rig)
    remedy = f".venv/bin/python -m tests.hardware.acceptance {rig}"
    if not path.is_file():
        return unknown(NAME, "this rig was never measured", remedy)
    try:
        report = files.read_json(path, kind=FORMAT, version=VERSION)
        date, steps = str(report["date"])[:10], [(str(one["name"]), one["verdict"] == PASSED) for one in report["steps"]]
    except (KoalaError, KeyError, TypeError) as error:
        return wrong(NAME, f"{path} cannot be read: {error}", f"measure again: {remedy}", blocks=False)
    failed = [name for name, passed in steps if not passed]
    if failed:
        found = f"{date}, {len(failed)} of {len(steps)} steps not passed: {', '.join(failed)}"
        return wrong(NAME, found, f"see {path}; mend it, then measure again: {remedy}", blocks=False)
    return ok(NAME, f"{date}, all {len(steps)} steps passed")
