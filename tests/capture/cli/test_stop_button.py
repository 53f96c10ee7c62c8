"""The stop button of the page that `capture run --view` shows."""

import subprocess
import sys
from pathlib import Path

import pytest

from koala3d.capture.rig.controllers import write_simulated_rig
from koala3d.capture.rig.naming import describe
from koala3d.capture.sim.controller.process import SimulatedController
from tests.browser import Browse
from tests.capture.cli.test_cli import SESSION
from tests.capture.moving import moves, rests
from tests.moments import until

BLOCKED = "signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])"
IGNORED = "signal.signal(signal.SIGINT, signal.SIG_IGN)"
"""As shells start a command that a script puts into the background."""


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("interrupt", "words"),
    [
        pytest.param(IGNORED, "stopped by Ctrl-C or from the page, the arm stands still", id="in the background"),
        pytest.param(BLOCKED, "the motion was stopped on request (the arm stands still)", id="while no interrupt arrives"),
    ],
)
def test_it_stops_the_arm_and_the_session(tmp_path: Path, browse: Browse, interrupt: str, words: str) -> None:
    session, rig, out = tmp_path / "slow.yaml", tmp_path / "rig.yaml", tmp_path / "rec"
    slow = "motion: {speed: 0.02, acceleration: 1.4}\n"
    session.write_text(SESSION.replace("COUNT", "3").replace("TRAIN", "2") + slow)
    with SimulatedController.as_built(seed=0, time_scale=1.0) as simulated:
        write_simulated_rig(rig, simulated, "grey_card", 0, describe("sim"))
        code = f"import os, signal, sys; {interrupt}; os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
        run = ["run", str(session), "--rig", str(rig), "--out", str(out), "--view", "--port", "0"]
        command = [sys.executable, "-c", code, "-m", "koala3d.capture.cli", *run]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        try:
            assert process.stderr is not None
            said = next(line for line in process.stderr if "shows the session" in line)
            with browse(said.split()[0], expected="WebSocket connection to .* failed") as window:
                until(lambda: moves(simulated), "the first motion")
                window.page.get_by_text("stop the arm").click()
                error = process.communicate(timeout=120)[1]
            assert rests(simulated) and not (out / "frames.jsonl").exists()  # the first motion takes more than a minute
        finally:
            process.kill()
    assert process.returncode == 1 and error.count("error:") == 1 and words in error, error
