"""The HTML report of a recording: findings, exposure, sharpness and joint angles over time, a thumbnail of every picture."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.trajectory import recorded_trajectory
from koala3d.capture.recording import check
from koala3d.capture.recording.focus import sharpness
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import CHOSEN, Frame, Recording, chosen_views
from koala3d.datasets.reports.html import Number, ReportPage

THUMBNAIL = 190  # width of the small pictures [px]


@dataclass(frozen=True)
class Measured:
    """Measurements on one picture."""

    frame: Frame
    thumbnail: NDArray[np.uint8] | None  # (h, w, 3) sRGB bytes; None if the picture cannot be read
    sharpness: float | None = None
    white: float | None = None  # share of white pixels
    bright: float | None = None  # 99th percentile of the luminance, as a share of white


def write(
    path: Path, out: Path, *, made_by: str = "", done: Callable[[int, int], None] = lambda count, total: None
) -> list[check.Finding]:
    """Write the report of a recording to the new file `out`; returns the findings.

    Args:
        done: called with the number of pictures read and the total; each picture is read twice.

    Raises UsageError: `out` exists, or `path` is not a recording.
    """
    files.refuse_existing(out)
    recording = Recording.open(path)
    total = 2 * len(recording.frames)
    findings = check.check(path, done=lambda count, _: done(count, total))
    measured = []
    for frame in recording.frames:
        measured.append(measure(recording, frame))
        done(len(recording.frames) + len(measured), total)
    page = ReportPage(f"Recording {recording.manifest.get('name', path.name)}", made_by=[made_by] if made_by else [])
    _head(page, recording, findings)
    _findings(page, findings)
    page.section("Over the session")
    if len(measured) > 1:
        page.drawing(over_time(measured))
    page.section("Every view")
    page.table(
        ("view", "split", "at", "exposure", "settled for", "sharpness", "white pixels", "99 % darker than"),
        (_row(one, measured[0]) for one in measured),
    )
    _chosen(page, recording)
    page.section("Pictures")
    page.pictures((f"{one.frame.name} ({one.frame.split})", one.thumbnail) for one in measured if one.thumbnail is not None)
    _rig(page, recording)
    page.write(out)
    return findings


def measure(recording: Recording, frame: Frame) -> Measured:
    """Measure one picture; without measurements if it cannot be read."""
    try:
        light = images.read(recording.image_path(frame))[..., :3]
    except KoalaError:
        return Measured(frame, None)
    pixels = np.rint(light * 65535).astype(np.uint16)
    white, bright = check.exposure(pixels)
    small = images.resize(light, THUMBNAIL, max(1, round(THUMBNAIL * light.shape[0] / light.shape[1])))
    return Measured(frame, images.to_uint8(small), sharpness(pixels), white, bright)


def _head(page: ReportPage, recording: Recording, findings: list[check.Finding]) -> None:
    frames, wrong = recording.frames, [finding for finding in findings if not finding.note]
    seconds = 1e-9 * (frames[-1].host_time_ns - frames[0].host_time_ns) if len(frames) > 1 else None
    figures = [
        ("views", Number(len(frames), digits=0)),
        ("findings", Number(len(wrong), digits=0)),
        ("from first to last", Number(seconds, "s", digits=0)),
        ("exposure", Number(1e-3 * recorded_trajectory(recording).camera.exposure_us, "ms")),
    ]
    scene = recording.manifest.get("scene")
    simulated = f", scene {scene}, seed {recording.manifest.get('seed')}" if scene else ""
    page.headline(figures, f"{recording.path}{simulated}")


def _findings(page: ReportPage, findings: list[check.Finding]) -> None:
    page.section("Findings of 'capture check'")
    if not findings:
        return page.paragraph("Nothing is wrong.")
    page.items(finding.line if finding.note else f"error: {finding.line}" for finding in findings)
    if again := check.to_take_again(findings):
        advice = "'capture check --discard' removes them, and 'capture run --resume' retakes them."
        page.paragraph(f"To retake: {', '.join(again)}. {advice}")


def _chosen(page: ReportPage, recording: Recording) -> None:
    """Why each view was taken, where the session chose its views."""
    if not (reasons := chosen_views(recording)):
        return
    ended = recording.part(CHOSEN).get("ended")
    words = f"Ended: {ended['words']}." if isinstance(ended, dict) and "words" in ended else "The session has not ended."
    page.section("Why each view was taken", words)
    page.table(("view", "why", "covered before"), (_reason(name, why) for name, why in sorted(reasons.items())))


def _reason(name: str, why: dict[str, Any]) -> tuple:
    covered = why.get("covered")
    return name, str(why.get("words", "")), Number(None if covered is None else 100 * covered, "%", digits=1)


def _row(one: Measured, first: Measured) -> tuple:
    frame = one.frame
    return (
        frame.name,
        frame.split,
        Number(1e-9 * (frame.host_time_ns - first.frame.host_time_ns), "s", digits=1),
        Number(1e-3 * frame.exposure_us, "ms"),
        Number(frame.settle_s, "s", digits=2),
        Number(one.sharpness, digits=2),
        *(Number(None if share is None else 100 * share, "%", digits=1) for share in (one.white, one.bright)),
    )


def over_time(measured: list[Measured]) -> str:
    """Sharpness, light and joint angles over the time of the session, as SVG in colours for light and dark."""
    from koala3d.datasets.reports.drawing import COLOURS, blank, svg_of

    seconds = np.array([1e-9 * (one.frame.host_time_ns - measured[0].frame.host_time_ns) for one in measured])
    figure = blank(9, 6)
    rows = figure.subplots(3, 1, sharex=True)
    values = {
        "sharpness": [one.sharpness for one in measured],
        "99th percentile [%]": [one.bright and 100 * one.bright for one in measured],
    }
    for axes, (label, column) in zip(rows, values.items(), strict=False):
        axes.plot(seconds, np.array(column, float), "o-", color=COLOURS[0], markersize=3, linewidth=1)
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0)
    for joint, angles in enumerate(np.rad2deg([one.frame.joints for one in measured]).T):
        style = {"color": COLOURS[joint % len(COLOURS)], "markersize": 2.5, "linewidth": 1}
        rows[2].plot(seconds, angles, "o-", label=f"joint {joint + 1}", **style)
    rows[2].set(xlabel="time [s]", ylabel="joint angles [°]")
    rows[2].legend(ncols=6, frameon=False, fontsize=8)
    for axes in rows:
        axes.grid(alpha=0.25)
    return svg_of(figure)


def _rig(page: ReportPage, recording: Recording) -> None:
    page.section("Robot, camera and software")
    described = [(key, recording.manifest.get(key, "")) for key in ("started", "software")]
    for part in ("robot", "camera"):
        described += [(f"{part}: {key}", value) for key, value in recording.part(part).items()]
    page.table(("what", "value"), [(key, str(value)) for key, value in described if isinstance(value, str | int | float)])
