"""The acceptance protocol from its first to its last step, with the simulated controller and the emulated camera."""

import threading
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.cli import main
from koala3d.capture.doctor import acceptance
from koala3d.capture.doctor.lines import Verdict
from koala3d.capture.drivers.cameras.basler import Basler
from koala3d.capture.sim.controller.process import SimulatedController
from koala3d.datasets.core import files
from tests.hardware.acceptance import accept
from tests.moments import until

pytestmark = pytest.mark.client("koala")


@pytest.fixture
def controller():
    with SimulatedController.as_built(seed=2, time_scale=1.0) as found:
        yield found


def test_every_step_is_done_and_reported(controller, client, run_inside, tmp_path: Path):
    rig, asked = tmp_path / "lab.yaml", []
    rig.write_text(f"robot: {{host: {controller.host}, client: {client}}}\n")
    before = np.array(controller.ask("truth")["joints"])

    def open_fence() -> None:
        until(lambda: np.abs(np.array(controller.ask("truth")["joints"]) - before).max() > 0.01, "the creeping joint")
        controller.ask("safeguard")

    def operator(question: str) -> bool:
        asked.append(question)
        if "open the fence" in question:
            threading.Thread(target=open_fence, daemon=True).start()
        if "Close the fence" in question:
            controller.ask("safety")
        return "Joint 5 turns" not in question

    steps = accept(rig, operator, lambda settings: Basler(settings, emulated=True, sums=True))
    verdicts = {step.name: step.verdict for step in steps}
    assert verdicts.pop("joint 5 by two degrees") == "skipped"
    assert set(verdicts.values()) == {"passed"}, [(step.name, step.found) for step in steps]
    assert {"noise at rest", "tool accelerometer", "watchdog", "safeguard stop", "exposure steps", "binning modes"} <= set(
        verdicts
    )
    assert len(asked) >= len(steps)
    by_name = {step.name: step.measured for step in steps}
    assert by_name["noise at rest"]["noise_rad"] == pytest.approx(4e-6, rel=0.5)
    assert 0.1 < by_name["watchdog"]["ended_s"] < 0.5 and by_name["watchdog"]["period_s"] == 0.2
    assert by_name["replies while our program runs"]["programState"].startswith("PLAYING")
    assert by_name["exposure steps"]["exposures"][3]["actual_us"] == 1015.0  # 1007 in rows of 35 us
    assert by_name["binning modes"]["binning"][1]["binning_modes"] == {"horizontal": "Sum", "vertical": "Average"}
    np.testing.assert_allclose(controller.ask("truth")["joints"], before, atol=1e-3)

    report = files.read_json(tmp_path / "lab.acceptance.json", kind=acceptance.FORMAT, version=acceptance.VERSION)
    assert report["robot"]["model"] == "UR5e" and [one["name"] for one in report["steps"]] == [step.name for step in steps]
    text = (tmp_path / "lab.acceptance.txt").read_text()
    assert "watchdog" in text and "ms after the kill, stated 200 ms" in text
    shown = partial(run_inside, main, "capture")("doctor", "--rig", rig, "--seconds", 0.2).stdout
    (row,) = [line for line in shown.splitlines() if line.startswith("acceptance")]
    assert "wrong" in row and f"{report['date'][:10]}, 1 of {len(steps)} steps not passed: joint 5 by two degrees" in row


def test_what_the_doctor_says_of_a_report(tmp_path: Path):
    rig = tmp_path / "lab.yaml"
    never = acceptance.check(rig)
    assert never.verdict is Verdict.UNKNOWN and "tests.hardware.acceptance" in never.remedy
    report = {"format": acceptance.FORMAT, "version": 1, "date": "2026-11-28T03:00:00+00:00"}
    files.write_json(tmp_path / "lab.acceptance.json", {**report, "steps": [{"name": "watchdog", "verdict": "passed"}]})
    assert acceptance.check(rig).verdict is Verdict.OK and acceptance.check(rig).found == "2026-11-28, all 1 steps passed"
    files.write_json(tmp_path / "lab.acceptance.json", report)
    broken = acceptance.check(rig)
    assert broken.verdict is Verdict.WRONG and not broken.blocks and "measure again" in broken.remedy
