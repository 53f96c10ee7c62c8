"""The report of a run: one HTML file with everything in it, pictures included, for a browser and for later.

DIR/index.html    result, figures, error over time, truth and rendering side by side, the commands that made it
DIR/strip.png     one view in a row: photograph, rendering, normals, depth, specular part
"""

import base64
import html
import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets import files, images
from datasets.console import progress
from datasets.scene import View
from reconstruct import metrics
from reconstruct.evaluate import FORMAT, METRICS, VERSION, evaluate, read_truth
from reconstruct.export import brightness_of_depth
from reconstruct.page import PAGE
from reconstruct.renderer import Picture
from reconstruct.run import Run
from reconstruct.trained import Trained

VIEWS = 4
"""Test views shown."""
GOOD = ("psnr", "ssim", "normal_mae_alpha_acc_deg", "depth_rmse_mm")
"""Figures of the line at the top."""
NAMES = {
    "psnr": "PSNR", "ssim": "SSIM", "normal_mae_alpha_acc_deg": "normals, mean angle (alpha × opacity)", "normal_mae_deg": "normals, mean angle (alpha)",
    "normal_pred_mae_alpha_acc_deg": "predicted normals (alpha × opacity)", "normal_pred_mae_deg": "predicted normals (alpha)",
    "disparity_rmse": "disparity RMSE", "depth_rmse_mm": "depth RMSE", "depth_median_mm": "depth, median error",
    "diffuse_psnr": "PSNR, diffuse part", "specular_psnr": "PSNR, specular part", "seconds": "time per view",
    "chamfer_mm": "mesh, Chamfer distance", "accuracy_mm": "mesh to truth", "completeness_mm": "truth to mesh", "f_score": "mesh, F-score",
    "hand_eye_mm": "hand-eye pose, position", "hand_eye_deg": "hand-eye pose, angle", "camera_mm": "camera poses, position (median)",
    "camera_deg": "camera poses, angle (median)", "held_out_px": "corners on unseen views", "held_out_mm": "the same at the target",
}  # fmt: skip
"""What figures are called in the report."""
Figure = tuple[str, float | None, str, str]
"""Name, value, unit, meaning."""


def write(trained: Trained, out: Path, *, calibration: Path | None = None) -> dict[str, Any]:
    """Write the report of a trained model into the new folder `out`; measures the model first where that is not done yet.

    Args:
        calibration: file of 'calib handeye' whose figures are to be shown, with the error against a simulation's truth.

    Raises:
        Misuse: `out` holds something.
    """
    files.refuse_existing(out)
    calibrated = _calibration_scores(calibration)
    run, result = trained.run, _measured(trained)
    views = trained.scene.split(result["split"])
    chosen = views[:: max(1, len(views) // VIEWS)][:VIEWS]
    rows = []
    with files.atomic_folder(out) as folder:
        with progress("rendering the report", len(chosen), "views") as shown:
            for view in chosen:
                truth, picture = read_truth(view, trained.camera(view)), trained.picture(view)
                if not rows:
                    images.write(folder / "strip.png", strip_of(truth, picture))
                rows.append(_row(view, side_by_side(truth, picture)))
                shown.advance()
        page = PAGE.substitute(
            title=html.escape(f"{trained.scene.name}: {run.config.model}"), headline=_headline(run, result),
            figures=_table(_scores(result)), mesh=_section("Mesh", _mesh_scores(result)),
            calibration=_section("Calibration", calibrated), curve=_curve(run), views="\n".join(rows),
            work=_work(run, result), commands=html.escape(_commands(run, out, calibration)),
        )  # fmt: skip
        files.write_text(folder / "index.html", page)
    return {"report": str(out / "index.html"), "views": len(chosen), "mean": result["mean"]}


def _measured(trained: Trained) -> dict[str, Any]:
    """The run's metrics, if they are of this state; else measured anew."""
    path = trained.run.path / METRICS
    result = files.read_json(path, kind=FORMAT, version=VERSION) if path.is_file() else {}
    return result if result.get("steps") == int(trained.state.step) else evaluate(trained)


def side_by_side(
    truth: dict[str, NDArray[np.float32]], picture: Picture
) -> dict[str, tuple[NDArray[np.floating] | None, NDArray[np.floating]]]:
    """(truth, rendering) of each channel as pictures 0..1; None where the truth is not known.

    Depth is drawn over the range of the truth where there is one; normals as (n + 1) / 2, grey where nothing is.
    """
    alpha = (truth["alpha"] > 0.5) if "alpha" in truth else None
    pairs: dict[str, tuple[NDArray[np.floating] | None, NDArray[np.floating]]] = {"colour": (truth["rgb"], picture.rgb)}
    true_normals = (truth["normals"] + 1) / 2 if "normals" in truth else None
    pairs["normals"] = (true_normals, (_where(picture.normals, alpha if true_normals is not None else None) + 1) / 2)
    if "depth" in truth and alpha is not None:
        known = np.where(alpha, truth["depth"], 0)
        limits = tuple(np.percentile(known[known > 0], [1, 99])) if (known > 0).any() else (0.0, 1.0)
        pairs["depth"] = (brightness_of_depth(known, limits), brightness_of_depth(_where(picture.depth, alpha), limits))
    else:
        pairs["depth"] = (None, brightness_of_depth(picture.depth))
    for name in ("diffuse", "specular"):
        shown = [
            images.srgb_from_linear(np.maximum(part, 0)) for part in (truth.get(name), getattr(picture, name)) if part is not None
        ]
        pairs[name] = (shown[0] if len(shown) == 2 else None, shown[-1])
    return pairs


def strip_of(truth: dict[str, NDArray[np.float32]], picture: Picture) -> NDArray[np.float32]:
    """(height, width, 3) one row: photograph, rendering, normals, depth, specular part."""
    pairs = side_by_side(truth, picture)
    shown = [pairs["colour"][0], *(pairs[name][1] for name in ("colour", "normals", "depth", "specular"))]
    gap = np.ones((picture.rgb.shape[0], max(2, picture.rgb.shape[1] // 60), 3), np.float32)
    row: list[NDArray[np.float32]] = []
    for part in shown:
        row += [np.broadcast_to(np.clip(part, 0, 1), (*part.shape[:2], 3)), gap]
    return np.concatenate(row[:-1], axis=1)


def _where(values: NDArray[np.float32], shown: NDArray[np.bool_] | None) -> NDArray[np.float32]:
    return values if shown is None else np.where(shown, values, 0)


def _row(view: View, pairs: dict[str, tuple[NDArray | None, NDArray]]) -> str:
    cells = []
    for name, (truth, rendered) in pairs.items():
        first = f'<img src="{_embedded(truth)}" alt="{name}, truth">' if truth is not None else '<div class="none">no truth</div>'
        second = f'<img src="{_embedded(rendered)}" alt="{name}, rendered">'
        cells.append(f"<figure>{first}{second}<figcaption>{name}</figcaption></figure>")
    return f'<h3>view {html.escape(view.name)}</h3><div class="row">{"".join(cells)}</div>'


def _embedded(picture: NDArray) -> str:
    """A picture as a PNG inside the page."""
    from matplotlib import image

    pixels = images.to_uint8(np.broadcast_to(picture, (*picture.shape[:2], 3)))
    buffer = io.BytesIO()
    image.imsave(buffer, pixels, format="png")
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


def _scores(result: dict[str, Any]) -> list[Figure]:
    return [(NAMES[name], value, *metrics.DEFINITIONS[name]) for name, value in result["mean"].items()]


def _mesh_scores(result: dict[str, Any]) -> list[Figure]:
    scores = result.get("mesh") or {}
    units = result.get("mesh_definitions", {})
    return [
        (NAMES[name], value, "mm" if name.endswith("_mm") else "", units.get(name, ""))
        for name, value in scores.items()
        if name in NAMES
    ]


def _calibration_scores(path: Path | None) -> list[Figure]:
    """Figures of a calibration, and how far it is from the truth where the recording was simulated."""
    from datasets.calibration import Calibration
    from datasets.truth import calibration_error, has_truth

    if path is None:
        return []
    calibration = Calibration.load(path)
    scores: list[Figure] = []
    recording = Path(calibration.provenance.get("recording", ""))
    if calibration.flange_from_camera is not None and has_truth(recording):
        error = calibration_error(recording, calibration)
        for name in ("hand_eye_mm", "hand_eye_deg", "camera_mm", "camera_deg"):
            scores.append((NAMES[name], error[name], name.rsplit("_", 1)[1], "error against the truth of the simulation"))
    for name in ("held_out_px", "held_out_mm"):
        if calibration.residuals.get(name) is not None:
            scores.append(
                (
                    NAMES[name],
                    calibration.residuals[name],
                    name.rsplit("_", 1)[1],
                    "root mean square, each view predicted from the others",
                )
            )
    return scores


def _table(scores: list[Figure]) -> str:
    rows = []
    for name, value, unit, meaning in scores:
        shown = "–" if value is None else f"{value:.4g}" if abs(value) < 10 else f"{value:.2f}"
        rows.append(
            f"<tr><th>{html.escape(name)}</th><td class=number>{shown}</td><td>{unit}</td><td>{html.escape(meaning)}</td></tr>"
        )
    return f"<table>{''.join(rows)}</table>"


def _section(title: str, scores: list[Figure]) -> str:
    return f"<h2>{title}</h2>{_table(scores)}" if scores else ""


def _headline(run: Run, result: dict[str, Any]) -> str:
    """The result in one line."""
    parts = []
    for name in GOOD:
        value = result["mean"].get(name)
        if value is not None:
            label = {"psnr": "PSNR", "ssim": "SSIM", "normal_mae_alpha_acc_deg": "normals", "depth_rmse_mm": "depth"}[name]
            parts.append(
                f"<b>{value:.3f}</b> {label}" if name == "ssim" else f"<b>{value:.2f} {metrics.DEFINITIONS[name][0]}</b> {label}"
            )
    log = run.log()
    trained = f", after {log[-1]['seconds']:.0f} s of training ({log[-1]['step']} steps)" if log else ""
    return (
        f"{' · '.join(parts)}<br>on {result['views']} {result['split']} views at {result['size'][0]}×{result['size'][1]}{trained}"
    )


def _curve(run: Run) -> str:
    """PSNR over the seconds of training, as SVG that takes the page's colours."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure as Drawing

    log = run.log()
    if len(log) < 2:
        return "<p>The log is too short for a curve.</p>"
    drawing = Drawing(figsize=(8, 3.2), layout="constrained", facecolor="none")
    axes = drawing.add_subplot(facecolor="none")
    for key, label, colour in (
        ("psnr_unseen", "unseen views", "#2f6fde"),
        ("psnr_train", "training rays (last batch)", "#d98324"),
    ):
        points = [(line["seconds"], line[key]) for line in log if key in line]
        if points:
            axes.plot(*zip(*points, strict=True), label=label, color=colour, linewidth=2 if key == "psnr_unseen" else 1.2)
    axes.set(xlabel="seconds of training", ylabel="PSNR [dB]")
    axes.grid(alpha=0.25)
    legend = axes.legend(frameon=False, loc="lower right")
    for text in (
        axes.xaxis.label,
        axes.yaxis.label,
        *axes.get_xticklabels(),
        *axes.get_yticklabels(),
        *legend.get_texts(),
    ):
        text.set_color("#808080")
    for line in (*axes.spines.values(), *axes.xaxis.get_ticklines(), *axes.yaxis.get_ticklines()):
        line.set_color("#808080")
    buffer = io.StringIO()
    FigureCanvasSVG(drawing).print_svg(buffer, metadata={"Date": None})
    return buffer.getvalue()[buffer.getvalue().index("<svg") :]


def _work(run: Run, result: dict[str, Any]) -> str:
    """What the training did and what it could leave out, as list items."""
    log, content = run.log(), run.content
    facts = [
        f"preset {run.config.preset}, model {run.config.model}, sampler {run.config.sampler.kind}, on {content.get('device', 'unknown device')}"
    ]
    if log and "occupied" in log[-1]:
        facts.append(f"{100 * log[-1]['occupied']:.2f} % of the cells hold anything at the end; the others are skipped")
    if log:
        facts.append(f"{log[-1]['skipped']} of {log[-1]['step']} steps were left out because their gradient was not finite")
    facts.append(f"{result['mean']['seconds']:.2f} s per rendered view, all channels and density normals included")
    facts += [str(note) for note in content.get("notes", [])]
    return "".join(f"<li>{html.escape(fact)}</li>" for fact in facts)


def _commands(run: Run, out: Path, calibration: Path | None) -> str:
    path = run.path
    budget = run.content.get("budget_s")
    scale = f" --set scale={run.config.scale:g}" if run.config.scale != 1 else ""
    train = f"reconstruct train {run.scene_path} --model {run.config.model} --preset {run.config.preset}{scale}"
    if "from" in run.content:
        train = f"reconstruct train --from {run.content['from']} --finetune"
    lines = [f"{train}{f' --budget {budget:g}' if budget else ''} --out {path}", f"reconstruct eval {path}"]
    return "\n".join([*lines, f"reconstruct report {path}{f' --calibration {calibration}' if calibration else ''} --out {out}"])
