"""The report of a run: one self-contained HTML file.

DIR/index.html    results, metrics, error over time, renderings over the truth, the commands that made it
DIR/strip.png     one view in a row: image, rendering, normals, depth, specular part
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core import files
from koala3d.datasets.core.console import progress
from koala3d.datasets.imaging import images
from koala3d.datasets.reports.html import Number, ReportPage
from koala3d.reconstruct.output import metrics, schedule_plot
from koala3d.reconstruct.output.evaluate import current, read_truth
from koala3d.reconstruct.output.export import brightness_of_depth
from koala3d.reconstruct.output.metric_names import NAMES, mesh_note, unit
from koala3d.reconstruct.output.shape import uncertainty
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.rendering.pictures import Picture
from koala3d.reconstruct.run import Run
from koala3d.reconstruct.scene import poses
from koala3d.reconstruct.training.beginning.series import WEIGHTS
from koala3d.reconstruct.training.decisions import record

VIEWS = 4
CALIBRATION_ERRORS = {
    "hand_eye_mm": "hand-eye pose, position",
    "hand_eye_deg": "hand-eye pose, angle",
    "camera_mm": "camera poses, position (median)",
    "camera_deg": "camera poses, angle (median)",
}
"""Names of the errors against the truth of a simulation."""
HELD_OUT = {"held_out_px": "corners on held-out views", "held_out_mm": "corners on held-out views, at the target"}
HEADLINE = {
    "psnr": ("PSNR", 2),
    "ssim": ("SSIM", 3),
    "psnr_inside": ("PSNR inside the mask", 2),
    "normal_mae_alpha_acc_deg": ("normals, mean error", 2),
    "depth_median_mm": ("depth, median error", 2),
}
"""Name and digits of the metrics in the headline."""
Measurement = tuple[str, Number, str]  # name, value with its unit, meaning
Pair = tuple[NDArray[np.floating] | None, NDArray[np.floating]]  # truth, if it is known, and rendering


def write(trained: TrainedModel, out: Path, *, calibration: Path | None = None) -> dict[str, Any]:
    """Write the report of a trained model into the new folder `out`; evaluate the model first if needed.

    Args:
        calibration: file of 'calib handeye' to report the accuracy of, against the truth if the recording was simulated.

    Raises UsageError: `out` is not empty.
    """
    files.refuse_existing(out)
    calibrated = _calibration_scores(calibration)
    run, result = trained.run, current(trained)
    views = trained.scene.split(result["split"])
    chosen = views[:: max(1, len(views) // VIEWS)][:VIEWS]
    page = ReportPage(f"{trained.scene.name}: {run.config.model}", made_by=_commands(run, result, out, calibration))
    page.headline(*_headline(run, result))
    page.section("Test views", "Left of the line is the truth, right of it the rendering; the pointer moves the line.")
    with files.atomic_folder(out) as folder:
        with progress("rendering the report", len(chosen), "views") as shown:
            for index, view in enumerate(chosen):
                truth, picture = read_truth(view, trained.camera(view), trained.run.copies), trained.picture(view)
                if index == 0:
                    images.write(folder / "strip.png", strip_of(truth, picture))
                page.heading(f"view {view.name}")
                page.wipes((name, *pair) for name, pair in side_by_side(truth, picture).items())
                shown.advance()
        _rest(page, run, result, calibrated)
        page.write(folder / "index.html")
    return {"report": str(out / "index.html"), "views": len(chosen), "mean": result["mean"]}


def _rest(page: ReportPage, run: Run, result: dict[str, Any], calibrated: list[Measurement]) -> None:
    """Everything except images and headline."""
    page.section("Mean over the test views")
    page.numbers(_scores(result))
    side = result.get("mesh_stands_on")
    measured_mesh = f"Of {mesh_note(side)}." if side else ""
    certainty = _certainty_scores(run, result)
    sections = (
        ("Mesh", _mesh_scores(result), measured_mesh),
        ("How certain the shape is", certainty, "Of the mesh that reconstruct mesh made last; it is not compared with a truth."),
        ("Calibration", calibrated, ""),
    )
    for title, scores, lead in sections:
        if scores:
            page.section(title, lead)
            page.numbers(scores)
    page.section("Each test view")
    columns = [name for name in metrics.DEFINITIONS if any(view.get(name) is not None for view in result["per_view"])]
    rows = [(view["name"], *(Number(view.get(name), unit(name)) for name in columns)) for view in result["per_view"]]
    page.table(("view", *(NAMES[name] for name in columns)), rows)
    page.section("Error over time")
    if (drawn := _curve(run)) is None:
        page.paragraph("The log is too short for a curve.")
    else:
        page.drawing(drawn)
    page.section("Training")
    page.items(_facts(run, result))
    page.drawing(
        schedule_plot.drawn(run.config), "what followed the progress of the training, each relative to its largest value"
    )
    if skips := record.read(run.path):
        page.section("Skips", "--no-skip NAME prevents a skip.")
        body = []
        for one in skips:
            name, decision = one.name if one.name in record.NAMES else "", "skipped" if one.skipped else "kept"
            body.append((one.what, name, decision, one.evidence, one.saving))
        page.table(("what", "name", "decision", "evidence", "saving"), body)


def side_by_side(truth: dict[str, NDArray[np.float32]], picture: Picture) -> dict[str, Pair]:
    """(truth, rendering) of each channel as images in 0..1.

    Depth is scaled to the range of the true depth if it is known; normals are drawn as (n + 1) / 2, grey for the background.
    """
    alpha = (truth["alpha"] > 0.5) if "alpha" in truth else None
    pairs: dict[str, Pair] = {"colour": (truth["rgb"], picture.rgb)}
    true_normals = (truth["normals"] + 1) / 2 if "normals" in truth else None
    pairs["normals"] = (true_normals, (_where(picture.normals, alpha if true_normals is not None else None) + 1) / 2)
    if "depth" in truth and alpha is not None:
        known = np.where(alpha, truth["depth"], 0)
        near, far = np.percentile(known[known > 0], [1, 99]) if (known > 0).any() else (0.0, 1.0)
        limits = (float(near), float(far))
        pairs["depth"] = (brightness_of_depth(known, limits), brightness_of_depth(_where(picture.depth, alpha), limits))
    else:
        pairs["depth"] = (None, brightness_of_depth(picture.depth))
    for name in ("diffuse", "specular"):
        true = images.srgb_from_linear(np.maximum(truth[name], 0)) if name in truth else None
        pairs[name] = (true, images.srgb_from_linear(np.maximum(getattr(picture, name), 0)))
    return pairs


def strip_of(truth: dict[str, NDArray[np.float32]], picture: Picture) -> NDArray[np.float32]:
    """(height, width, 3) one row: image, rendering, normals, depth, specular part."""
    pairs = side_by_side(truth, picture)
    shown = [pairs["colour"][0], *(pairs[name][1] for name in ("colour", "normals", "depth", "specular"))]
    gap = np.ones((picture.rgb.shape[0], max(2, picture.rgb.shape[1] // 60), 3), np.float32)
    row: list[NDArray[np.float32]] = []
    for part in shown:
        row += [np.broadcast_to(np.clip(part, 0, 1), (*part.shape[:2], 3)), gap]
    return np.concatenate(row[:-1], axis=1)


def _where(values: NDArray[np.float32], shown: NDArray[np.bool_] | None) -> NDArray[np.float32]:
    return values if shown is None else np.where(shown, values, 0)


def _scores(result: dict[str, Any]) -> list[Measurement]:
    return [(NAMES[name], Number(value, unit(name)), metrics.DEFINITIONS[name][1]) for name, value in result["mean"].items()]


def _mesh_scores(result: dict[str, Any]) -> list[Measurement]:
    scores = result.get("mesh") or {}
    meanings = result.get("mesh_definitions", {})
    return [(NAMES[name], Number(value, unit(name)), meanings.get(name, "")) for name, value in scores.items() if name in NAMES]


def _certainty_scores(run: Run, result: dict[str, Any]) -> list[Measurement]:
    """What `reconstruct mesh` has stated of the shape's errors."""
    found = uncertainty.stored(run.path, result["steps"])
    if found is None or found["expected_error"] is None:
        return []
    factor, unit = (1e3, "mm") if found["metric"] else (1.0, "")
    low, high = found["expected_error"]["interval"]
    scores: list[Measurement] = [
        ("expected error", Number(factor * found["expected_error"]["value"], unit), found["definitions"]["expected_error"]),
        ("between", Number(factor * low, unit), "lower end of the interval"),
        ("and", Number(factor * high, unit), "upper end"),
        ("known surface", Number(100 * found["known_share"], "%"), found["definitions"]["known_share"]),
    ]
    if found["scale_std"] is not None:
        scores.append(("size", Number(100 * found["scale_std"], "%"), found["definitions"]["scale_std"]))
        scores.append(("place", Number(factor * found["place_std"], unit), found["definitions"]["place_std"]))
    return scores


def _calibration_scores(path: Path | None) -> list[Measurement]:
    """Accuracy of a calibration, and its error if the recording was simulated."""
    from koala3d.datasets.calibration import Calibration
    from koala3d.datasets.checks.truth import calibration_error, has_truth

    if path is None:
        return []
    calibration = Calibration.load(path)
    scores: list[Measurement] = []
    recording = Path(calibration.provenance.get("recording", ""))
    if calibration.flange_from_camera is not None and has_truth(recording):
        error = calibration_error(recording, calibration)
        for key, name in CALIBRATION_ERRORS.items():
            scores.append((name, Number(error[key], key.rsplit("_", 1)[1]), "error against the truth of the simulation"))
    for key, name in HELD_OUT.items():
        if (residual := getattr(calibration.residuals, key)) is not None:
            value = Number(residual, key.rsplit("_", 1)[1])
            scores.append((name, value, "root mean square, each view predicted from the others"))
    return scores


def _headline(run: Run, result: dict[str, Any]) -> tuple[list[tuple[str, Number]], str]:
    """The main results, and the views that they were measured on."""
    mean = result["mean"]
    known = [name for name in HEADLINE if mean.get(name) is not None]
    shown = [(HEADLINE[name][0], Number(mean[name], unit(name), digits=HEADLINE[name][1])) for name in known]
    if result.get("mesh"):
        shown.append((NAMES["chamfer_mm"], Number(result["mesh"]["chamfer_mm"], "mm", digits=2)))
    log = run.log()
    trained = f", after {log[-1]['seconds']:.0f} s of training ({log[-1]['step']} steps)" if log else ""
    return shown, f"on {result['views']} {result['split']} views at {result['size'][0]}×{result['size'][1]}{trained}"


def _curve(run: Run) -> str | None:
    """PSNR over the seconds of training as SVG; None if the log is too short."""
    from koala3d.datasets.reports.drawing import COLOURS, blank, svg_of

    log = run.log()
    if len(log) < 2:
        return None
    drawing = blank(8, 3.2)
    axes = drawing.add_subplot()
    curves = (("psnr_unseen", "test views", COLOURS[0], 2), ("psnr_train", "training rays (last batch)", COLOURS[1], 1.2))
    for key, label, colour, width in curves:
        points = [(line["seconds"], line[key]) for line in log if key in line]
        if points:
            axes.plot(*zip(*points, strict=True), label=label, color=colour, linewidth=width)
    axes.set(xlabel="seconds of training", ylabel="PSNR [dB]")
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, loc="lower right")
    return svg_of(drawing)


def _facts(run: Run, result: dict[str, Any]) -> list[str]:
    """Facts about the training, a sentence each."""
    log, content = run.log(), run.content
    device = content.get("device", "unknown device")
    facts = [f"preset {run.config.preset}, model {run.config.model}, sampler {run.config.sampler.kind}, on {device}"]
    if log and "occupied" in log[-1]:
        facts.append(f"{100 * log[-1]['occupied']:.0f} % of the space is occupied at the end; the rest is skipped")
    if log and log[-1]["skipped"]:
        facts.append(f"{log[-1]['skipped']} of {log[-1]['step']} steps were skipped because their gradient was not finite")
    if refined := poses.summary(run.path):
        facts.append(refined)
    if "aligned" in result:
        facts.append(f"with the pose of each view aligned to the model, PSNR is {result['aligned']['mean']['psnr']:.2f} dB")
    facts.append(f"{result['mean']['seconds']:.2f} s per rendered view, including all channels and density normals")
    return [*facts, *(str(note) for note in content.get("notes", []))]


def _commands(run: Run, result: dict[str, Any], out: Path, calibration: Path | None) -> list[str]:
    """The command lines that lead to the report."""
    path = run.path
    budget = run.content.get("budget_s")
    scale = f" --set scale={run.config.scale:g}" if run.config.scale != 1 else ""
    train = f"reconstruct train {run.scene_path} --model {run.config.model} --preset {run.config.preset}{scale}"
    if "from" in run.content:
        train = f"reconstruct train --from {run.content['from']} --finetune"
    if WEIGHTS in run.content:
        train = f"reconstruct train {run.scene_path} --from {run.content[WEIGHTS]['run']}"
    stands_on = f" --stands-on {side}" if (side := result.get("mesh_stands_on")) else ""
    aligned = " --align" if "aligned" in result else ""
    lines = [f"{train}{f' --budget {budget:g}' if budget else ''} --out {path}", f"reconstruct eval {path}{stands_on}{aligned}"]
    return [*lines, f"reconstruct report {path}{f' --calibration {calibration}' if calibration else ''} --out {out}"]
