"""Whatever the noise of an arm's encoders, its views settle: a whole session on a simulated rig."""

from functools import partial
from pathlib import Path

import pytest

from koala3d.capture.cli import main
from koala3d.datasets.recording import Recording

SESSION = """\
format: koala-trajectory
version: 1
name: noise
views:
  - {kind: hemisphere, target: [0.4, 0.0, 0.1], distance: 0.4, elevation_deg: [40, 60], azimuth_deg: [150, 210], rings: 1,
     count: 4, roll_deg: [0, 90, 180, 270]}
split: null
object: {centre: [0.4, 0.0, 0.1], size: [0.2, 0.2, 0.2]}
camera: {exposure_us: 10000, binning: 4, width: 48, height: 48}
"""


@pytest.mark.parametrize("noise", [*(pytest.param(one, marks=pytest.mark.slow) for one in (1e-6, 1.1e-5, 2e-5)), 4e-5])
def test_every_view_settles_whatever_the_noise_of_the_encoders(run_inside, tmp_path: Path, noise: float) -> None:
    small, rig, out = tmp_path / "small.yaml", tmp_path / "noisy.yaml", tmp_path / "rec"
    small.write_text(SESSION)
    rig.write_text(f"simulation: {{scene: shiny_ball, flaws: {{encoder_noise_rad: {noise:g}}}}}\n")
    done = partial(run_inside, main, "capture")("run", small, "--rig", rig, "--out", out)
    assert done.returncode == 0, done.stderr
    recording = Recording.open(out)
    assert len(recording.frames) == 4 and "incidents" not in recording.manifest
    assert max(frame.settle_s for frame in recording.frames) < 2.0
