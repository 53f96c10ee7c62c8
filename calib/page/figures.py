"""Pictures of a calibration, each as the bytes of a PNG file."""

import io
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from koala3d.calib.arrays import Array
from koala3d.calib.handeye import verify
from koala3d.calib.intrinsics.over_image import Map
from koala3d.calib.page.evidence import CalibrationEvidence
from koala3d.datasets import pose
from koala3d.datasets.calibration import UncertainPose
from koala3d.datasets.camera_model import Camera

CHI2_95 = 5.991  # 95 % point of chi-square with two degrees of freedom: the truth lies in the ellipse in 95 of 100 sessions


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _png(figure: Figure) -> bytes:
    data = io.BytesIO()
    figure.savefig(data, dpi=90)
    return data.getvalue()


def _over_image(camera: Camera, title: str) -> tuple[Figure, Any]:
    """A figure with axes in pixels of a camera's image."""
    figure = _figure(8, 8 * camera.height / camera.width + 0.6)
    axes = figure.add_subplot()
    axes.set(xlim=(0, camera.width), ylim=(camera.height, 0), xlabel="column [px]", ylabel="row [px]", title=title)
    axes.set_aspect("equal")
    return figure, axes


def residual_vectors(evidence: CalibrationEvidence, kind: str) -> bytes:
    """Every corner's residual where it was seen, enlarged; outliers in red."""
    good, camera = evidence.inliers, evidence.calibration.camera
    residuals, outliers = evidence.residuals[kind][good], int((~good).sum())
    lengths = np.linalg.norm(residuals, axis=1)
    enlarged = 0.03 * camera.width / max(float(np.percentile(lengths, 95)), 1e-9)
    figure, axes = _over_image(camera, f"residuals, {kind}, {enlarged:.0f} times enlarged; {outliers} outliers (red)")
    style: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.0015, "cmap": "viridis"}
    limits = (0, float(np.percentile(lengths, 98)))
    drawn = axes.quiver(*evidence.pixels[good].T, *(enlarged * residuals).T, lengths, clim=limits, **style)
    figure.colorbar(drawn, ax=axes, label="residual [px]", shrink=0.8)
    axes.plot(*evidence.pixels[~good].T, "rx", markersize=4)
    return _png(figure)


def view_errors(evidence: CalibrationEvidence) -> bytes:
    """Residual of each view and, where there is an arm, the correction of its report."""
    names = [o.name for o in evidence.session.observations]
    own = [evidence.inliers & (evidence.view == i) for i in range(len(names))]
    rms = [verify.rms(evidence.residuals[evidence.kind][chosen]) if chosen.any() else np.nan for chosen in own]
    bars: list[tuple[Any, str]] = [(rms, "residual [px]")]
    if evidence.corrections is not None:
        sizes = np.linalg.norm(evidence.corrections.reshape(-1, 2, 3), axis=2)
        bars += [(1e3 * sizes[:, 0], "arm error [mm]"), (np.rad2deg(sizes[:, 1]), "arm error [°]")]
    figure = _figure(9, 2 * len(bars))
    rows = figure.subplots(len(bars), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (values, label) in zip(rows, bars, strict=True):
        axes.bar(range(len(names)), values, color="tab:blue")
        axes.set_ylabel(label)
    rows[-1].set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    rows[-1].set_xlabel("view")
    return _png(figure)


def coverage(evidence: CalibrationEvidence) -> bytes:
    """Where in the image corners were seen, and the tilt and roll of the board in each view."""
    camera, session = evidence.calibration.camera, evidence.session
    pixels = np.concatenate([o.pixels for o in session.observations])
    figure = _figure(11, 4.4)
    left = figure.add_subplot(1, 2, 1)
    counts, _, _ = np.histogram2d(pixels[:, 1], pixels[:, 0], bins=(8, 8), range=((0, camera.height), (0, camera.width)))
    shown = left.imshow(counts, extent=(0, camera.width, camera.height, 0), cmap="Blues", aspect="equal")
    figure.colorbar(shown, ax=left, label="corners", shrink=0.8)
    left.set(xlabel="column [px]", ylabel="row [px]", title="corners over the image")
    used = {o.name for o in session.observations}
    boards = evidence.boards[[o.name in used for o in evidence.everything.observations]]
    normals, roll = boards[:, :3, 2], np.rad2deg(np.arctan2(boards[:, 1, 0], boards[:, 0, 0]))
    direction, tilt = np.arctan2(normals[:, 1], normals[:, 0]), np.rad2deg(np.arccos(np.clip(normals[:, 2], -1, 1)))
    right = figure.add_subplot(1, 2, 2, projection="polar")
    drawn = right.scatter(direction, tilt, c=roll, cmap="twilight", clim=(-180, 180))
    figure.colorbar(drawn, ax=right, label="roll about the axis [°]", shrink=0.8)
    right.set_title("tilt of the board [°] by direction")
    return _png(figure)


def ellipses(title: str, value: UncertainPose) -> bytes:
    """95 % confidence ellipses of position and of rotation in the three planes."""
    parts = (("mm", 1e6 * value.origin_covariance), ("°", np.rad2deg(1) ** 2 * value.covariance[3:, 3:]))
    figure = _figure(9, 6)
    grid = figure.subplots(2, 3)
    for row, (unit, covariance) in zip(grid, parts, strict=True):
        size = 1.1 * np.sqrt(CHI2_95 * np.diag(covariance).max())
        for axes, (i, j) in zip(row, ((0, 1), (0, 2), (1, 2)), strict=True):
            _ellipse(axes, covariance[np.ix_([i, j], [i, j])])
            axes.set(xlim=(-size, size), ylim=(-size, size), xlabel=f"{'xyz'[i]} [{unit}]", ylabel=f"{'xyz'[j]} [{unit}]")
            axes.set_aspect("equal")
            axes.locator_params(nbins=3)
            axes.grid(alpha=0.3)
    figure.suptitle(f"{title}: 95 % confidence ellipses (above: position, below: rotation)")
    return _png(figure)


def _ellipse(axes: Any, covariance: Array) -> None:
    values, vectors = np.linalg.eigh(covariance)
    width, height = 2 * np.sqrt(CHI2_95 * np.maximum(values, 0))
    angle = float(np.rad2deg(np.arctan2(vectors[1, 0], vectors[0, 0])))
    axes.add_patch(Ellipse((0, 0), width, height, angle=angle, facecolor="tab:blue", alpha=0.3, edgecolor="tab:blue"))


def difference_map(difference: Map, evidence: CalibrationEvidence) -> bytes:
    """Where cameras from two halves of the session disagree."""
    title = f"cameras of two halves of the views, {difference.rms_px:.3f} px rms; white: corners"
    figure, axes = _mapped(evidence.calibration.camera, title, difference, "difference [px]")
    axes.plot(*evidence.pixels.T, ",", color="white", alpha=0.5)
    return _png(figure)


def map_over_image(camera: Camera, title: str, values: Map, label: str) -> bytes:
    """Values over the image of a camera, with lines of equal value; a wide range is shown by its logarithm."""
    low, high = float(values.values_px.min()), float(values.values_px.max())
    wide = 0 < 0.01 * high < low < 0.2 * high
    figure, axes = _mapped(camera, title, values, label, "log" if wide else None)
    if high > low:
        levels = np.geomspace(low, high, 7)[1:-1] if wide else np.linspace(low, high, 7)[1:-1]
        lines = axes.contour(values.columns, values.rows, values.values_px, colors="white", linewidths=0.7, levels=levels)
        axes.clabel(lines, fontsize=8, fmt="%.2g")
    return _png(figure)


def _mapped(camera: Camera, title: str, values: Map, label: str, norm: str | None = None) -> tuple[Figure, Any]:
    figure, axes = _over_image(camera, title)
    style: dict[str, Any] = {"cmap": "magma", "shading": "nearest", "norm": norm}
    shown = axes.pcolormesh(values.columns, values.rows, values.values_px, **style)
    figure.colorbar(shown, ax=axes, label=label, shrink=0.8)
    return figure, axes


def rotations(evidence: CalibrationEvidence) -> bytes:
    """Rotation vectors of the flange between any two views: hand-eye calibration needs them to differ in direction."""
    flange = evidence.session.base_from_flange
    first, second = np.triu_indices(len(flange), 1)
    turns = np.rad2deg(pose.rotation_vector(flange[first, :3, :3] @ np.swapaxes(flange[second, :3, :3], 1, 2)))
    figure = _figure(9, 3.4)
    row = figure.subplots(1, 3)
    for axes, (i, j) in zip(row, ((0, 1), (0, 2), (1, 2)), strict=True):
        for sign in (1, -1):
            axes.plot(sign * turns[:, i], sign * turns[:, j], ".", markersize=3, alpha=0.6, color="tab:blue")
        axes.set(xlabel=f"about {'xyz'[i]} of the base [°]", ylabel=f"about {'xyz'[j]} [°]", aspect="equal")
        axes.grid(alpha=0.3)
    figure.suptitle("rotations of the flange between any two views")
    return _png(figure)
