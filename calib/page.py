"""A calibration as one HTML page that needs nothing else: figures inside, no scripts, no network."""

import base64
import html
from pathlib import Path

from calib import crossval, figures, intrinsics
from calib.calibrate import Solution
from calib.errors import CalibrationError
from calib.report import describe_calibration
from datasets import files
from datasets.calibration import Calibration

_STYLE = """body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #222 }
pre { background: #f4f4f4; padding: 1rem; overflow-x: auto } img { max-width: 100%; height: auto } table { border-collapse: collapse }
td, th { padding: .2rem .8rem; border-bottom: 1px solid #ddd; text-align: left } p { max-width: 46rem }"""


def write(path: Path, calibration: Calibration, solution: Solution) -> None:
    """Write the page to `path`. Raises Misuse where something is there already."""
    files.refuse_existing(path)
    files.write_text(path, render(calibration, solution))


def render(calibration: Calibration, solution: Solution) -> str:
    """The page as text."""
    parts = [
        _section("Result", f"<pre>{html.escape(describe_calibration(calibration))}</pre>"),
        _section("Views left out", _left_out(solution)),
        _picture("Residuals over the image", "Arrows that point the same way in one region mean a lens that the model does not follow.",
                 figures.residual_vectors(solution)),
        _picture("Views", "A view that stands out was blurred, taken in motion, or is in truth two.", figures.view_errors(solution)),
        _picture("Coverage", "Distortion is known where corners were seen; the centre of the image from tilts on all sides.",
                 figures.coverage(solution)),
        _picture("Rotations", "Turns about at least two axes are needed; the further the points reach on all sides, the better.",
                 figures.rotations(solution)),
    ]  # fmt: skip
    for name in ("flange_from_camera", "base_from_camera", "base_from_board", "flange_from_board"):
        value = getattr(calibration, name)
        if value is not None:
            parts.append(_picture(f"Uncertainty of {name}", "", figures.ellipses(name, value)))
    parts.append(_cross_validation(calibration, solution))
    return (f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>Calibration</title><style>{_STYLE}</style></head>'
            f"<body>\n<h1>Calibration</h1>\n{''.join(parts)}</body></html>\n")  # fmt: skip


def _section(title: str, body: str) -> str:
    return f"<h2>{html.escape(title)}</h2>\n{body}\n"


def _picture(title: str, words: str, png: bytes) -> str:
    data = base64.b64encode(png).decode()
    return _section(title, f'<p>{html.escape(words)}</p><img alt="{html.escape(title)}" src="data:image/png;base64,{data}">')


def _left_out(solution: Solution) -> str:
    rows = [(name, "no target was found") for name in solution.first.session.unseen] + list(solution.left_out.items())
    if not rows:
        return "<p>None.</p>"
    cells = "".join(f"<tr><td>{html.escape(name)}</td><td>{html.escape(why)}</td></tr>" for name, why in rows)
    return f"<table><tr><th>view</th><th>why</th></tr>{cells}</table>"


def _cross_validation(calibration: Calibration, solution: Solution) -> str:
    """The map of differences between two halves of the views; a sentence where a half is not enough."""
    title = "Two halves of the views"
    free = tuple(name for name in calibration.camera_std if name not in ("fx", "fy", "cx", "cy"))
    if not calibration.camera_std:
        return _section(title, "<p>The camera was given; nothing of it was estimated.</p>")
    session = solution.fit.session
    boards = intrinsics.camera_from_boards(calibration.camera, session.observations)
    lens = intrinsics.Lens(free, calibration.camera.fisheye)
    try:
        difference = crossval.cross_validate(calibration.camera, lens, session.observations, boards)
    except CalibrationError as error:
        return _section(title, f"<p>{html.escape(str(error))}</p>")
    return _picture(title, "Where cameras from two halves of the views disagree, the calibration is not to be trusted.",
                    figures.difference_map(difference, solution))  # fmt: skip
