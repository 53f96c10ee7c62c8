"""Pictures of a calibration, each as the bytes of a PNG file."""

import io
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from numpy.typing import NDArray

from calib.calibrate import Solution
from calib.intrinsics.crossval import Difference
from datasets import pose
from datasets.calibration import UncertainPose

Array = NDArray[np.float64]
CHI2_95 = 5.991
"""95 % point of chi-square with two degrees of freedom: an ellipse holds the truth in 95 of 100 sessions."""


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _png(figure: Figure) -> bytes:
    data = io.BytesIO()
    figure.savefig(data, dpi=90)
    return data.getvalue()


def residual_vectors(solution: Solution) -> bytes:
    """Every corner's residual where it was seen, enlarged; corners left out in red."""
    refined, measured, camera = solution.fit.refined, solution.fit.measured, solution.first.camera
    good = refined.inliers
    lengths = np.linalg.norm(refined.residuals[good], axis=1)
    enlarged = 0.03 * camera.width / max(float(np.percentile(lengths, 95)), 1e-9)
    figure = _figure(8, 8 * camera.height / camera.width + 0.6)
    axes = figure.add_subplot()
    x, y = measured.pixels[good].T
    u, v = (enlarged * refined.residuals[good]).T
    drawn = axes.quiver(x, y, u, v, lengths, angles="xy", scale_units="xy", scale=1, width=0.0015, cmap="viridis",
                        clim=(0, float(np.percentile(lengths, 98))))  # fmt: skip
    figure.colorbar(drawn, ax=axes, label="residual [px]", shrink=0.8)
    axes.plot(*measured.pixels[~good].T, "rx", markersize=4)
    axes.set(xlim=(0, camera.width), ylim=(camera.height, 0), aspect="equal", xlabel="column [px]", ylabel="row [px]",
             title=f"residuals, {enlarged:.0f} times enlarged; {int((~good).sum())} corners left out (red)")  # fmt: skip
    return _png(figure)


def view_errors(solution: Solution) -> bytes:
    """Residual and correction of the arm's report, view by view."""
    refined, measured = solution.fit.refined, solution.fit.measured
    names = [o.name for o in solution.fit.session.observations]
    rms = [float(np.sqrt(np.mean(np.sum(refined.residuals[chosen] ** 2, -1)))) if (chosen := refined.inliers & (measured.view == i)).any() else np.nan
           for i in range(len(names))]  # fmt: skip
    sizes = np.linalg.norm(refined.state.corrections.reshape(-1, 2, 3), axis=2)
    figure = _figure(9, 6)
    rows = figure.subplots(3, 1, sharex=True)
    for axes, values, label in zip(rows, (rms, 1e3 * sizes[:, 0], np.rad2deg(sizes[:, 1])),
                                   ("residual [px]", "arm off by [mm]", "arm off by [°]"), strict=True):  # fmt: skip
        axes.bar(range(len(names)), values, color="tab:blue")
        axes.set_ylabel(label)
    rows[2].set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    rows[2].set_xlabel("view")
    return _png(figure)


def coverage(solution: Solution) -> bytes:
    """Where in the image corners were seen, and from which sides and how turned the board was."""
    session, camera = solution.fit.session, solution.first.camera
    pixels = np.concatenate([o.pixels for o in session.observations])
    figure = _figure(11, 4.4)
    left = figure.add_subplot(1, 2, 1)
    counts, _, _ = np.histogram2d(pixels[:, 1], pixels[:, 0], bins=(8, 8), range=((0, camera.height), (0, camera.width)))
    shown = left.imshow(counts, extent=(0, camera.width, camera.height, 0), cmap="Blues", aspect="equal")
    figure.colorbar(shown, ax=left, label="corners", shrink=0.8)
    left.set(xlabel="column [px]", ylabel="row [px]", title="corners over the image")
    right = figure.add_subplot(1, 2, 2, projection="polar")
    boards = solution.boards[
        np.isin([o.name for o in solution.first.session.observations], [o.name for o in session.observations])
    ]
    normals = boards[:, :3, 2]
    roll = np.rad2deg(np.arctan2(boards[:, 1, 0], boards[:, 0, 0]))
    drawn = right.scatter(np.arctan2(normals[:, 1], normals[:, 0]), np.rad2deg(np.arccos(np.clip(normals[:, 2], -1, 1))), c=roll,
                          cmap="twilight", clim=(-180, 180))  # fmt: skip
    figure.colorbar(drawn, ax=right, label="roll about the axis [°]", shrink=0.8)
    right.set_title("tilt of the board [°] by direction")
    return _png(figure)


def ellipses(title: str, value: UncertainPose) -> bytes:
    """95 % ellipses of position and of rotation in the three planes."""
    x, y, z = value.matrix[:3, 3]
    of_origin = np.hstack([np.eye(3), [[0, z, -y], [-z, 0, x], [y, -x, 0]]])
    parts = (("mm", 1e6 * of_origin @ value.covariance @ of_origin.T), ("°", np.rad2deg(1) ** 2 * value.covariance[3:, 3:]))
    figure = _figure(9, 6)
    grid = figure.subplots(2, 3)
    for row, (unit, covariance) in zip(grid, parts, strict=True):
        size = 1.1 * np.sqrt(CHI2_95 * np.diag(covariance).max())
        for axes, (i, j) in zip(row, ((0, 1), (0, 2), (1, 2)), strict=True):
            _ellipse(axes, covariance[np.ix_([i, j], [i, j])])
            axes.set(
                xlim=(-size, size),
                ylim=(-size, size),
                aspect="equal",
                xlabel=f"{'xyz'[i]} [{unit}]",
                ylabel=f"{'xyz'[j]} [{unit}]",
            )
            axes.locator_params(nbins=3)
            axes.grid(alpha=0.3)
    figure.suptitle(f"{title}: where the truth is, 95 of 100 times (above: position, below: rotation)")
    return _png(figure)


def _ellipse(axes: Any, covariance: Array) -> None:
    values, vectors = np.linalg.eigh(covariance)
    width, height = 2 * np.sqrt(CHI2_95 * np.maximum(values, 0))
    angle = float(np.rad2deg(np.arctan2(vectors[1, 0], vectors[0, 0])))
    axes.add_patch(Ellipse((0, 0), width, height, angle=angle, facecolor="tab:blue", alpha=0.3, edgecolor="tab:blue"))


def difference_map(difference: Difference, solution: Solution) -> bytes:
    """Where two halves of the session disagree about the camera."""
    camera = solution.first.camera
    figure = _figure(8, 8 * camera.height / camera.width + 0.6)
    axes = figure.add_subplot()
    shown = axes.pcolormesh(difference.columns, difference.rows, difference.distance_px, cmap="magma", shading="nearest")
    figure.colorbar(shown, ax=axes, label="difference [px]", shrink=0.8)
    pixels = np.concatenate([o.pixels for o in solution.fit.session.observations])
    axes.plot(*pixels.T, ",", color="white", alpha=0.5)
    axes.set(xlim=(0, camera.width), ylim=(camera.height, 0), aspect="equal", xlabel="column [px]", ylabel="row [px]",
             title=f"cameras of two halves of the views, {difference.rms_px:.3f} px rms; white: corners")  # fmt: skip
    return _png(figure)


def rotations(solution: Solution) -> bytes:
    """Axis and angle of the turns of the flange between views, which hand-eye calibration lives on."""
    flange = solution.fit.session.base_from_flange
    first, second = np.triu_indices(len(flange), 1)
    turns = np.rad2deg(pose.rotation_vector(flange[first, :3, :3] @ np.swapaxes(flange[second, :3, :3], 1, 2)))
    figure = _figure(9, 3.4)
    row = figure.subplots(1, 3)
    for axes, (i, j) in zip(row, ((0, 1), (0, 2), (1, 2)), strict=True):
        axes.plot(turns[:, i], turns[:, j], ".", markersize=3, alpha=0.6)
        axes.plot(-turns[:, i], -turns[:, j], ".", markersize=3, alpha=0.6, color="tab:blue")
        axes.set(xlabel=f"about {'xyz'[i]} of the base [°]", ylabel=f"about {'xyz'[j]} [°]", aspect="equal")
        axes.grid(alpha=0.3)
    figure.suptitle("turns of the flange between any two views")
    return _png(figure)
