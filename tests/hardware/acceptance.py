"""The acceptance protocol of a rig: small, slow steps, each confirmed, whose results are stored beside the rig file.

.venv/bin/python -m tests.hardware.acceptance my_rig.yaml

Somebody holds the emergency stop. One joint turns at a time, by two degrees at most. Writes my_rig.acceptance.json, which
'capture doctor' mentions, and the same for people in my_rig.acceptance.txt.
"""

import sys
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from koala3d.capture.doctor.acceptance import FORMAT, VERSION, report_of
from koala3d.capture.model.rig import RigDescription, load_rig
from koala3d.capture.rig.cameras import driver_of
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import KoalaError
from tests.hardware import arm_steps, camera_steps
from tests.hardware.camera_steps import MakeCamera
from tests.hardware.steps import Ask, Step, judged

ARM = (
    arm_steps.gravity,
    arm_steps.noise,
    arm_steps.moves,
    arm_steps.dashboard,
    arm_steps.stops,
    arm_steps.watchdog,
    arm_steps.safeguard,
)
CAMERA = (camera_steps.exposures, camera_steps.binning)


def accept(path: Path, ask: Ask, make_camera: MakeCamera | None = None) -> list[Step]:
    """Do every step with the rig of a file and write the report after each; a step that raises has failed.

    Args:
        make_camera: opens the camera with settings; None: that of the rig file.
    """
    rig = load_rig(path)
    make = make_camera or (lambda settings: driver_of(rig.camera, settings))
    about, steps = _about(rig), list[Step]()
    work: list[tuple[Any, Any]] = [(step, rig) for step in ARM] + [(step, make) for step in CAMERA]
    for step, subject in work:
        try:
            found = step(subject, ask)
        except (KoalaError, OSError) as error:
            found = judged(step.__name__, False, str(error))
        steps += found if isinstance(found, list) else [found]
        _write(path, about, steps)
    return steps


def _about(rig: RigDescription) -> dict[str, Any]:
    with arm_steps.robot_of(rig) as robot:
        return robot.description()


def _write(path: Path, about: dict[str, Any], steps: list[Step]) -> None:
    now = datetime.now().astimezone().isoformat(timespec="seconds")
    content = {"format": FORMAT, "version": VERSION, "date": now, "rig": path.name, "robot": about}
    content |= {"software": f"koala-capture {version('koala-capture')}", "steps": [vars(step) for step in steps]}
    files.write_json(report_of(path), content)
    width = max(len(step.name) for step in steps)
    head = f"{path.name}, {now}: {about.get('model')} {about.get('serial')}, {about.get('software')}, {about.get('client')}"
    lines = [f"{step.name:{width}}  {step.verdict:7}  {step.found}" for step in steps]
    files.write_text(report_of(path).with_suffix(".txt"), "\n".join([head, "", *lines]) + "\n")


def ask_operator(question: str) -> bool:
    """Enter goes on, s skips, Ctrl-C ends the protocol."""
    return input(f"{question}\n  Enter: go on, s: skip > ").strip().lower() != "s"


def main() -> None:
    """Run the protocol for the rig file that is named."""
    if len(sys.argv) != 2:
        sys.exit("give the rig file: python -m tests.hardware.acceptance RIG.yaml")
    path = Path(sys.argv[1])
    try:
        steps = accept(path, ask_operator)
    except KoalaError as error:
        sys.exit(f"error: {error}")
    sys.stdout.write(report_of(path).with_suffix(".txt").read_text())
    sys.exit(int(any(step.verdict == "failed" for step in steps)))


if __name__ == "__main__":
    main()
