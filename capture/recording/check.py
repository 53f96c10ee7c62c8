"""What is wrong with a recording, and which of its views to take again."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.recording.focus import luminance, sharpness
from capture.trajectory import Trajectory
from datasets.core import files
from datasets.core.errors import KoalaError
from datasets.imaging import images
from datasets.imaging.region import Region
from datasets.recording import FRAMES, Frame, Recording

OVER_SHARE, UNDER_LIGHT = 0.15, 0.03
"""Over-exposed: more than this share of the pixels is white. Under-exposed: 99 % of the pixels are darker than this share of it."""
BLURRED = 0.8
"""Less sharp than this share of the median picture of the recording."""
GAP, GAP_S = 10.0, 60.0
"""Time between two frames, in medians and in seconds, that is worth a word: light and warmth drift."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a recording."""

    what: str
    frame: str = ""
    """Name of the view; empty: it is the whole recording's."""
    why: str = ""
    again: bool = True
    """Whether taking the view again mends it."""
    note: bool = False
    """Worth knowing, but nothing is wrong: where a session was interrupted."""

    @property
    def line(self) -> str:
        """All of it in one line."""
        return ("note: " if self.note else "") + str(
            KoalaError(self.what, where=f"view {self.frame}" if self.frame else "", why=self.why)
        )


def check(path: Path, *, done: Callable[[int, int], None] = lambda count, total: None) -> list[Finding]:
    """Findings on a recording, in the order of its views; an empty list: nothing is wrong.

    Every image is read. `done` is called with the number of frames checked and of all.

    Raises:
        KoalaError: this is no recording, or its own files cannot be read.
    """
    recording = Recording.open(path)
    findings = [*_counts(recording), *_times(recording.frames), *_settings(recording)]
    sharp: dict[str, float] = {}
    for count, frame in enumerate(recording.frames, 1):
        pixels, found = _picture(recording, frame)
        findings += found
        if pixels is not None:
            findings += _exposure(frame.name, pixels)
            sharp[frame.name] = sharpness(pixels)
        done(count, len(recording.frames))
    findings += _blur(sharp)
    return sorted(findings, key=lambda finding: finding.frame)


def to_take_again(findings: list[Finding]) -> list[str]:
    """Names of the views to take again, in order."""
    return sorted({finding.frame for finding in findings if finding.frame and finding.again})


def discard(path: Path, names: list[str]) -> list[str]:
    """Take frames out of a recording, so that `capture run --resume` takes them again; returns those that were there.

    Their lines go first, in one step, then their images: a kill in between leaves an image without a line, which is the
    state after a kill during a capture.
    """
    recording = Recording.open(path)
    lines = (recording.path / FRAMES).read_text(encoding="utf-8").split("\n")[: len(recording.frames)] if recording.frames else []
    kept = [line for line, frame in zip(lines, recording.frames, strict=True) if frame.name not in names]
    gone = [frame for frame in recording.frames if frame.name in names]
    if gone:
        files.write_text(recording.path / FRAMES, "".join(f"{line}\n" for line in kept))
    for frame in gone:
        recording.image_path(frame).unlink(missing_ok=True)
    return [frame.name for frame in gone]


def _counts(recording: Recording) -> list[Finding]:
    wanted = [view.name for view in Trajectory.model_validate(recording.trajectory).viewpoints()]
    there = Counter(frame.name for frame in recording.frames)
    findings = [Finding("was never taken", name) for name in wanted if name not in there]
    findings += [
        Finding("was taken more than once", name, f"{count} lines in {FRAMES}") for name, count in there.items() if count > 1
    ]
    return findings + [Finding("is no view of the trajectory", name, again=False) for name in there if name not in wanted]


def _times(frames: list[Frame]) -> list[Finding]:
    """Clocks that stand still or run back, and breaks in the session."""
    findings = []
    for clock in ("host_time_ns", "robot_time_s", "device_ticks"):
        steps = np.diff([float(getattr(frame, clock)) for frame in frames])
        if clock == "device_ticks" and not np.any(steps):
            continue  # a camera without a clock
        usual = float(np.median(steps)) if len(steps) else 0.0
        for step, frame in zip(steps, frames[1:], strict=True):
            if step == 0:
                findings.append(Finding(f"{clock} stands still", frame.name, "it is that of the view before"))
            elif step < 0:
                why = "the session went on after a restart"
                findings.append(Finding(f"{clock} begins anew", frame.name, why, again=False, note=True))
            elif clock == "host_time_ns" and step > max(GAP * usual, GAP_S * 1e9):
                why = f"{step * 1e-9:.0f} s, usual {usual * 1e-9:.1f} s"
                findings.append(Finding("was taken after a gap", frame.name, why, again=False, note=True))
    return findings


def _settings(recording: Recording) -> list[Finding]:
    wanted = float(recording.trajectory["camera"]["exposure_us"])
    return [
        Finding("was exposed otherwise", frame.name, f"{frame.exposure_us:g} us, asked for {wanted:g}")
        for frame in recording.frames
        if abs(frame.exposure_us - wanted) > 0.01 * wanted + 1
    ]


def _picture(recording: Recording, frame: Frame) -> tuple[Any, list[Finding]]:
    """The image as 8 or 16 bits, where it is whole; and what is wrong with its file."""
    path = recording.image_path(frame)
    if not path.is_file():
        return None, [Finding("its image is missing", frame.name, frame.image)]
    if files.sha256(path) != frame.sha256:
        return None, [Finding("its image has changed", frame.name, "the hash is not that of the recording")]
    try:
        light = images.read(path)
    except KoalaError as error:
        return None, [Finding("its image cannot be read", frame.name, error.what)]
    region = Region.from_json(recording.manifest["camera"]["region"], where=recording.path)
    if light.shape[:2] != (region.height, region.width):
        return None, [
            Finding(
                "its image has another size", frame.name, f"{light.shape[1]}x{light.shape[0]}, not {region.width}x{region.height}"
            )
        ]
    return np.rint(light * 65535).astype(np.uint16), []


def exposure(pixels: NDArray[Any]) -> tuple[float, float]:
    """Share of white pixels of an 8- or 16-bit picture, and the light [share of white] below which 99 % of its pixels are."""
    white = float((pixels >= 0.996 * np.iinfo(pixels.dtype).max).any(axis=-1).mean())
    return white, float(np.percentile(luminance(pixels), 99))


def _exposure(name: str, pixels: NDArray[Any]) -> list[Finding]:
    white, bright = exposure(pixels)
    if white > OVER_SHARE:
        return [Finding("is over-exposed", name, f"{100 * white:.0f} % of the pixels are white; lower camera.exposure_us")]
    if bright < UNDER_LIGHT:
        return [Finding("is under-exposed", name, f"its light ends at {100 * bright:.1f} % of white; raise camera.exposure_us")]
    return []


def _blur(sharp: dict[str, float]) -> list[Finding]:
    usual = float(np.median(list(sharp.values()))) if sharp else 0.0
    return [
        Finding("is blurred", name, f"{100 * value / usual:.0f} % as sharp as the others")
        for name, value in sharp.items()
        if value < BLURRED * usual
    ]
