"""Checks of a recording: what is wrong with it, and which views to retake."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.trajectory import Trajectory, recorded_trajectory
from koala3d.capture.recording.focus import luminance, sharpness
from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.imaging import images
from koala3d.datasets.incidents import left_out
from koala3d.datasets.recording import FRAMES, Frame, Recording

OVER_SHARE, UNDER_LIGHT = 0.15, 0.03
"""A picture is over-exposed when more than this share of its pixels is white, and under-exposed when 99 % of them are below this
share of white."""
BLURRED = 0.8  # a picture is blurred below this share of the median sharpness of the recording
MOVED_M, MOVED_RAD = 1e-4, np.radians(0.01)
"""An arm has moved during an exposure when its poses before and after differ by more: a quarter of a pixel for a camera of
1300 pixels focal length, 0.4 m from the object. Noise of the encoders makes up a tenth of that."""
TURNED_RAD = np.radians(0.02)
"""A turntable has moved during an exposure when its angles before and after differ by more: 0.06 mm at 0.18 m from the axis."""
GAP, GAP_S = 10.0, 60.0
"""A gap between two frames is reported when it exceeds both this multiple of the median and this time: light and
temperature drift."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a recording."""

    what: str
    frame: str = ""  # name of the view; empty: the whole recording
    why: str = ""
    again: bool = True  # whether retaking the view fixes it
    note: bool = False  # information, not an error: where a session was interrupted

    @property
    def line(self) -> str:
        """The finding in one line."""
        return ("note: " if self.note else "") + str(
            KoalaError(self.what, where=f"view {self.frame}" if self.frame else "", why=self.why)
        )


def check(path: Path, *, done: Callable[[int, int], None] = lambda count, total: None) -> list[Finding]:
    """Findings on a recording, in the order of its views; empty where nothing is wrong.

    Every image is read. `done` is called with the number of checked frames and the total.

    Raises KoalaError: `path` is not a recording, or its files cannot be read.
    """
    recording = Recording.open(path)
    trajectory = recorded_trajectory(recording)
    findings = [*_counts(recording, trajectory), *_times(recording.frames), *_settings(recording, trajectory)]
    findings += _motion(recording.frames)
    sharp: dict[tuple[str, ...] | None, dict[str, float]] = {}  # of views under the same lamps
    for count, frame in enumerate(recording.frames, 1):
        pixels, found = _picture(recording, frame)
        findings += found + _exposures(recording, frame) + _depth(recording, frame)
        if pixels is not None:
            findings += _exposure(frame.name, pixels)
            sharp.setdefault(frame.lights, {})[frame.name] = sharpness(pixels)
        done(count, len(recording.frames))
    for alike in sharp.values():
        findings += _blur(alike)
    return sorted(findings, key=lambda finding: finding.frame)


def to_take_again(findings: list[Finding]) -> list[str]:
    """Names of the views to retake, in order."""
    return sorted({finding.frame for finding in findings if finding.frame and finding.again})


def _counts(recording: Recording, trajectory: Trajectory) -> list[Finding]:
    wanted = [view.name for view in trajectory.viewpoints()]
    there = Counter(frame.name for frame in recording.frames)
    why = dict.fromkeys(left_out(recording), "the arm did not come to rest")
    findings = [Finding("was never taken", name, why.get(name, "")) for name in wanted if name not in there]
    findings += [
        Finding("was taken more than once", name, f"{count} lines in {FRAMES}") for name, count in there.items() if count > 1
    ]
    return findings + [Finding("is not a view of the trajectory", name, again=False) for name in there if name not in wanted]


def _times(frames: list[Frame]) -> list[Finding]:
    """Clocks that stand still or run backwards, and gaps in the session."""
    findings = []
    for clock in ("host_time_ns", "robot_time_s", "device_ticks"):
        steps = np.diff([float(getattr(frame, clock)) for frame in frames])
        if clock == "device_ticks" and not np.any(steps):
            continue  # a camera without a clock
        usual = float(np.median(steps)) if len(steps) else 0.0
        for step, frame in zip(steps, frames[1:], strict=True):
            if step == 0:
                findings.append(Finding(f"{clock} stands still", frame.name, "same value as the previous view"))
            elif step < 0:
                why = "the session was resumed after a restart"
                findings.append(Finding(f"{clock} starts again", frame.name, why, again=False, note=True))
            elif clock == "host_time_ns" and step > max(GAP * usual, GAP_S * 1e9):
                why = f"{step * 1e-9:.0f} s, median {usual * 1e-9:.1f} s"
                findings.append(Finding("was taken after a gap", frame.name, why, again=False, note=True))
    return findings


def _settings(recording: Recording, trajectory: Trajectory) -> list[Finding]:
    stated = recording.part("camera").get("exposure_us")  # in the camera's own steps
    wanted = stated if isinstance(stated, int | float) else trajectory.camera.exposure_us
    return [
        Finding("has another exposure time", frame.name, f"{frame.exposure_us:g} us, requested {wanted:g} us")
        for frame in recording.frames
        if abs(frame.exposure_us - wanted) > 0.01 * wanted + 1
    ]


def _motion(frames: list[Frame]) -> list[Finding]:
    """Exposures before and after which the arm or the turntable was in different places."""
    findings = []
    for frame in frames:
        if frame.turntable_angle is not None and frame.turntable_angle_after is not None:
            turned = abs(frame.turntable_angle_after - frame.turntable_angle)
            if turned > TURNED_RAD:
                why = f"by {np.degrees(turned):.3f} degrees"
                findings.append(Finding("the turntable moved during the exposure", frame.name, why))
        if frame.base_from_flange_after is not None:
            distance, angle = map(float, pose.difference(frame.base_from_flange, frame.base_from_flange_after))
            if distance > MOVED_M or angle > MOVED_RAD:
                why = f"by {1e3 * distance:.2f} mm and {np.degrees(angle):.3f} degrees"
                findings.append(Finding("the arm moved during the exposure", frame.name, why))
    return findings


def _picture(recording: Recording, frame: Frame) -> tuple[Any, list[Finding]]:
    """The image with 16 bits, or None where it cannot be used, and what is wrong with its file."""
    path = recording.image_path(frame)
    if not path.is_file():
        return None, [Finding("its image is missing", frame.name, frame.image)]
    if files.sha256(path) != frame.sha256:
        return None, [Finding("its image has changed", frame.name, "its hash is not the recorded one")]
    try:
        light = images.read(path)
    except KoalaError as error:
        return None, [Finding("its image cannot be read", frame.name, error.what)]
    region = recording.region
    if region is not None and light.shape[:2] != (region.height, region.width):
        sizes = f"{light.shape[1]}x{light.shape[0]}, not {region.width}x{region.height}"
        return None, [Finding("its image has another size", frame.name, sizes)]
    return np.rint(light * 65535).astype(np.uint16), []


def _exposures(recording: Recording, frame: Frame) -> list[Finding]:
    """What is wrong with the files of the sensor's values."""
    findings = []
    for one in frame.exposures:
        path = recording.path / one.file
        if one.file != frame.image and not path.is_file():
            findings.append(Finding("a file of its exposures is missing", frame.name, one.file))
        elif one.file != frame.image and files.sha256(path) != one.sha256:
            findings.append(
                Finding("a file of its exposures has changed", frame.name, f"{one.file}: its hash is not the recorded one")
            )
    return findings


def _depth(recording: Recording, frame: Frame) -> list[Finding]:
    """What is wrong with the file of the measured depth."""
    if frame.depth is None:
        return []
    path = recording.path / frame.depth.file
    if not path.is_file():
        return [Finding("its depth is missing", frame.name, frame.depth.file)]
    if files.sha256(path) != frame.depth.sha256:
        return [Finding("its depth has changed", frame.name, f"{frame.depth.file}: its hash is not the recorded one")]
    return []


def exposure(pixels: NDArray[Any]) -> tuple[float, float]:
    """Share of white pixels of an 8- or 16-bit picture, and the 99th percentile of its luminance [share of white]."""
    white = float((pixels >= 0.996 * np.iinfo(pixels.dtype).max).any(axis=-1).mean())
    return white, float(np.percentile(luminance(pixels), 99))


def _exposure(name: str, pixels: NDArray[Any]) -> list[Finding]:
    white, bright = exposure(pixels)
    if white > OVER_SHARE:
        return [Finding("is over-exposed", name, f"{100 * white:.0f} % of the pixels are white; lower camera.exposure_us")]
    if bright < UNDER_LIGHT:
        why = f"99 % of the pixels are below {100 * bright:.1f} % of white; raise camera.exposure_us"
        return [Finding("is under-exposed", name, why)]
    return []


def _blur(sharp: dict[str, float]) -> list[Finding]:
    usual = float(np.median(list(sharp.values()))) if sharp else 0.0
    return [
        Finding("is blurred", name, f"{100 * value / usual:.0f} % of the median sharpness")
        for name, value in sharp.items()
        if value < BLURRED * usual
    ]
