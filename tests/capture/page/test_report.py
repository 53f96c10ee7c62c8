"""The report of a recording."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.page import report
from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import Frame, Recording


@pytest.fixture
def recorded(tmp_path: Path) -> Callable[..., Path]:
    """Factory of recordings of four pictures of squares, a second apart; one may be white, one gone."""

    def make(*, white: int = -1, missing: int = -1) -> Path:
        changes = [
            "views=[{kind: orbit, target: [0.4, 0, 0.14], distance: 0.4, count: 4}]",
            "split=null",
            "camera.width=120",
            "camera.height=96",
        ]
        trajectory = load_trajectory("koala_demo", overrides=changes)
        path = tmp_path / "recording"
        region = {"width": 120, "height": 96, "offset_x": 0, "offset_y": 0, "binning": 4}
        manifest = {"name": "<squares>", "trajectory": trajectory.model_dump(mode="json")}
        recording = Recording.create(path, manifest | {"camera": {"region": region, "model": "acA1920"}})
        for index in range(4):
            name = f"{index:03d}"
            plates = np.kron(np.random.default_rng(index).uniform(0.1, 0.9, (8, 10, 3)), np.ones((12, 12, 1)))
            picture = path / "images" / f"{name}.png"
            images.write(picture, (255 * (np.ones_like(plates) if index == white else plates)).astype(np.uint8))
            reached, joints = pose.look_at((0.4, 0, 0.5), (0, 0, 0)), np.full(6, 0.1 * index)
            clocks = (100.0 + index, 10**9 * (7 + index), 10**9 * (3 + index))
            image, digest = f"images/{name}.png", files.sha256(picture)
            recording.append(
                Frame(
                    index=index,
                    name=name,
                    split="train",
                    image=image,
                    base_from_flange=reached,
                    joints=joints,
                    robot_time_s=clocks[0],
                    host_time_ns=clocks[1],
                    device_ticks=clocks[2],
                    exposure_us=10_000.0,
                    settle_s=0.4,
                    sha256=digest,
                )
            )
            if index == missing:
                picture.unlink()
        return path

    return make


def test_a_good_recording_is_reported_completely(recorded: Callable[..., Path], tmp_path: Path) -> None:
    steps = []
    findings = report.write(recorded(), tmp_path / "page.html", made_by="capture check x", done=lambda *n: steps.append(n))
    text = (tmp_path / "page.html").read_text()
    assert findings == [] and "Nothing is wrong" in text and "capture check x" in text and "acA1920" in text
    assert "&lt;squares&gt;" in text and "<squares>" not in text
    assert text.count("<img") == 4 and text.count("<svg") == 1 and not re.search(r'src="(?!data:)', text)
    assert [count for count, _ in steps] == list(range(1, 9)) and {total for _, total in steps} == {8}
    assert "10.00 <small>ms</small>" in text


def test_findings_are_listed(recorded: Callable[..., Path], tmp_path: Path) -> None:
    findings = report.write(recorded(white=2, missing=3), tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert {finding.frame for finding in findings if not finding.note} == {"002", "003"}
    assert "is over-exposed" in text and "its image is missing" in text and "To retake: 002, 003" in text
    assert text.count("<img") == 3 and "100.0 <small>%</small>" in text


def test_nothing_is_overwritten(recorded: Callable[..., Path], tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text("mine")
    with pytest.raises(UsageError, match="already exists"):
        report.write(recorded(), tmp_path / "page.html")


def test_a_recording_without_frames_has_a_report(recorded: Callable[..., Path], tmp_path: Path) -> None:
    path = recorded()
    (path / "frames.jsonl").unlink()
    findings = report.write(path, tmp_path / "page.html")
    assert {finding.what for finding in findings} == {"was never taken"}
    assert "To retake: 000, 001, 002, 003" in (tmp_path / "page.html").read_text()
