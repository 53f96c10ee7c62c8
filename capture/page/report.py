"""A recording as one HTML file: what is wrong with it, how it was exposed, how sharp it is, where the arm stood, every picture small."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.recording import check
from capture.recording.focus import sharpness
from datasets.core import files
from datasets.core.errors import KoalaError
from datasets.imaging import images
from datasets.recording import Frame, Recording
from datasets.reports.html import Number, ReportPage

THUMBNAIL = 190
"""Width of the small pictures [px]."""


@dataclass(frozen=True)
class Look:
    """What one picture shows of how it was taken."""

    frame: Frame
    thumbnail: NDArray[np.uint8] | None
    """(h, w, 3) sRGB bytes; None where the picture cannot be read."""
    sharpness: float | None = None
    white: float | None = None
    """Share of the pixels."""
    bright: float | None = None
    """Light below which 99 % of the pixels are, as a share of white."""


def write(
    path: Path, out: Path, *, made_by: str = "", done: Callable[[int, int], None] = lambda count, total: None
) -> list[check.Finding]:
    """Write the report of a recording to the new file `out`; returns what is wrong with the recording.

    Args:
        path: of the recording.
        out: HTML file.
        made_by: the command.
        done: called with the number of pictures read and of all; each is read twice.

    Raises:
        UsageError: `out` exists, or `path` is no recording.
    """
    files.refuse_existing(out)
    recording = Recording.open(path)
    total = 2 * len(recording.frames)
    findings = check.check(path, done=lambda count, _: done(count, total))
    looks = []
    for frame in recording.frames:
        looks.append(look(recording, frame))
        done(len(recording.frames) + len(looks), total)
    page = ReportPage(f"Recording {recording.manifest.get('name', path.name)}", made_by=[made_by] if made_by else [])
    _head(page, recording, findings)
    _findings(page, findings)
    page.section("Over the session")
    if len(looks) > 1:
        page.drawing(over_time(looks))
    page.section("Every view")
    page.table(
        ("view", "split", "at", "exposure", "settled for", "sharpness", "white pixels", "99 % darker than"),
        map(_row, looks, [looks[0]] * len(looks)),
    )
    page.section("Pictures")
    page.pictures((f"{one.frame.name} ({one.frame.split})", one.thumbnail) for one in looks if one.thumbnail is not None)
    _rig(page, recording)
    page.write(out)
    return findings


def look(recording: Recording, frame: Frame) -> Look:
    """Read one picture; one that cannot be read has nothing but its line."""
    try:
        light = images.read(recording.image_path(frame))[..., :3]
    except KoalaError:
        return Look(frame, None)
    pixels = np.rint(light * 65535).astype(np.uint16)
    white, bright = check.exposure(pixels)
    small = images.resize(light, THUMBNAIL, max(1, round(THUMBNAIL * light.shape[0] / light.shape[1])))
    return Look(frame, images.to_uint8(small), sharpness(pixels), white, bright)


def _head(page: ReportPage, recording: Recording, findings: list[check.Finding]) -> None:
    frames, wrong = recording.frames, [finding for finding in findings if not finding.note]
    seconds = 1e-9 * (frames[-1].host_time_ns - frames[0].host_time_ns) if len(frames) > 1 else None
    page.headline(
        [("views", Number(len(frames), digits=0)), ("findings", Number(len(wrong), digits=0)), ("from first to last", Number(seconds, "s", digits=0)),
         ("exposure", Number(1e-3 * float(recording.trajectory["camera"]["exposure_us"]), "ms"))],
        f"{recording.path}, scene {recording.manifest['scene']}, seed {recording.manifest['seed']}" if recording.manifest.get("scene") else str(recording.path),
    )  # fmt: skip


def _findings(page: ReportPage, findings: list[check.Finding]) -> None:
    page.section("Findings of 'capture check'")
    if not findings:
        return page.paragraph("Nothing is wrong.")
    page.items(finding.line if finding.note else f"error: {finding.line}" for finding in findings)
    if again := check.to_take_again(findings):
        page.paragraph(
            f"To take again: {', '.join(again)}. 'capture check --discard' takes them out, then 'capture run --resume' takes them again."
        )


def _row(one: Look, first: Look) -> tuple:
    frame = one.frame
    percent = lambda value: Number(None if value is None else 100 * value, "%", digits=1)  # noqa: E731
    return (frame.name, frame.split, Number(1e-9 * (frame.host_time_ns - first.frame.host_time_ns), "s", digits=1),
            Number(1e-3 * frame.exposure_us, "ms"), Number(frame.settle_s, "s", digits=2), Number(one.sharpness, digits=2),
            percent(one.white), percent(one.bright))  # fmt: skip


def over_time(looks: list[Look]) -> str:
    """Sharpness, light and joint angles over the time of the session, as SVG in colours for light and dark."""
    from datasets.reports.drawing import COLOURS, blank, svg_of

    seconds = np.array([1e-9 * (one.frame.host_time_ns - looks[0].frame.host_time_ns) for one in looks])
    figure = blank(9, 6)
    rows = figure.subplots(3, 1, sharex=True)
    values = {
        "sharpness": [one.sharpness for one in looks],
        "99th percentile [%]": [one.bright and 100 * one.bright for one in looks],
    }
    for axes, (label, column) in zip(rows, values.items(), strict=False):
        axes.plot(seconds, np.array(column, float), "o-", color=COLOURS[0], markersize=3, linewidth=1)
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0)
    for joint, angles in enumerate(np.rad2deg([one.frame.joints for one in looks]).T):
        rows[2].plot(seconds, angles, "o-", color=COLOURS[joint], markersize=2.5, linewidth=1, label=f"joint {joint + 1}")
    rows[2].set(xlabel="time [s]", ylabel="joint angles [°]")
    rows[2].legend(ncols=6, frameon=False, fontsize=8)
    for axes in rows:
        axes.grid(alpha=0.25)
    return svg_of(figure)


def _rig(page: ReportPage, recording: Recording) -> None:
    page.section("With what")
    described = {"software": recording.manifest.get("software", "")}
    for part in ("robot", "camera"):
        described |= {
            f"{part}: {key}": value
            for key, value in recording.manifest.get(part, {}).items()
            if isinstance(value, str | int | float)
        }
    page.table(("what", "value"), [(key, str(value)) for key, value in described.items()])
