"""The report of a run: one HTML file with everything in it, pictures included, for a browser and for later.

DIR/index.html    result, figures, error over time, truth and rendering laid over each other, the commands that made it
DIR/strip.png     one view in a row: photograph, rendering, normals, depth, specular part
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.core import files
from datasets.core.console import progress
from datasets.imaging import images
from datasets.reports.html import Number, ReportPage
from reconstruct.output import metrics
from reconstruct.output.evaluate import FORMAT, METRICS, VERSION, evaluate, read_truth
from reconstruct.output.export import brightness_of_depth
from reconstruct.output.metric_names import NAMES, mesh_note, unit
from reconstruct.output.trained_model import TrainedModel
from reconstruct.rendering.pictures import Picture
from reconstruct.run import Run
from reconstruct.scene import poses
from reconstruct.training.skipping import record

VIEWS = 4
"""Test views shown."""
CALIBRATION = {
    "hand_eye_mm": "hand-eye pose, position", "hand_eye_deg": "hand-eye pose, angle", "camera_mm": "camera poses, position (median)",
    "camera_deg": "camera poses, angle (median)", "held_out_px": "corners on unseen views", "held_out_mm": "the same at the target",
}  # fmt: skip
"""What figures of a calibration are called."""
Figure = tuple[str, Number, str]
"""Name, value with its unit, meaning."""


def write(trained: TrainedModel, out: Path, *, calibration: Path | None = None) -> dict[str, Any]:
    """Write the report of a trained model into the new folder `out`; measures the model first where that is not done yet.

    Args:
        calibration: file of 'calib handeye' whose figures are to be shown, with the error against a simulation's truth.

    Raises:
        UsageError: `out` holds something.
    """
    files.refuse_existing(out)
    calibrated = _calibration_scores(calibration)
    run, result = trained.run, _measured(trained)
    views = trained.scene.split(result["split"])
    chosen = views[:: max(1, len(views) // VIEWS)][:VIEWS]
    page = ReportPage(f"{trained.scene.name}: {run.config.model}", made_by=_commands(run, result, out, calibration))
    page.headline(*_headline(run, result))
    page.section("Test views", "Move over a picture: left of the line is the truth, right of it the rendering.")
    with files.atomic_folder(out) as folder:
        with progress("rendering the report", len(chosen), "views") as shown:
            for index, view in enumerate(chosen):
                truth, picture = read_truth(view, trained.camera(view)), trained.picture(view)
                if index == 0:
                    images.write(folder / "strip.png", strip_of(truth, picture))
                page.heading(f"view {view.name}")
                page.wipes((name, *pair) for name, pair in side_by_side(truth, picture).items())
                shown.advance()
        _rest(page, run, result, calibrated)
        page.write(folder / "index.html")
    return {"report": str(out / "index.html"), "views": len(chosen), "mean": result["mean"]}


def _rest(page: ReportPage, run: Run, result: dict[str, Any], calibrated: list[Figure]) -> None:
    """Everything but pictures and headline."""
    page.section("Figures, mean over the test views")
    page.numbers(_scores(result))
    side = result.get("mesh_stands_on")
    measured_mesh = f"Of {mesh_note(side)}." if side else ""
    for title, scores, lead in (("Mesh", _mesh_scores(result), measured_mesh), ("Calibration", calibrated, "")):
        if scores:
            page.section(title, lead)
            page.numbers(scores)
    page.section("Each test view")
    columns = [name for name in metrics.DEFINITIONS if any(view.get(name) is not None for view in result["per_view"])]
    page.table(("view", *(NAMES[name] for name in columns)),
               [(view["name"], *(Number(view.get(name), unit(name)) for name in columns))
                for view in result["per_view"]])  # fmt: skip
    page.section("Error over time")
    if (drawn := _curve(run)) is None:
        page.paragraph("The log is too short for a curve.")
    else:
        page.drawing(drawn)
    page.section("What was done")
    page.items(_work(run, result))
    if skips := record.read(run.path):
        page.section("What was left out, and what was not", "A name is what --no-skip takes, to keep that in.")
        page.table(("what", "name", "decision", "evidence", "saving", "cost"),
                   [(record.in_words(one.name), one.name if one.name in record.NAMES else "", "left out" if one.skipped else "kept",
                     one.evidence, one.saving, one.cost) for one in skips])  # fmt: skip


def _measured(trained: TrainedModel) -> dict[str, Any]:
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


def _scores(result: dict[str, Any]) -> list[Figure]:
    figures = []
    for name, value in result["mean"].items():
        figures.append((NAMES[name], Number(value, unit(name)), metrics.DEFINITIONS[name][1]))
    return figures


def _mesh_scores(result: dict[str, Any]) -> list[Figure]:
    scores = result.get("mesh") or {}
    meanings = result.get("mesh_definitions", {})
    return [(NAMES[name], Number(value, unit(name)), meanings.get(name, "")) for name, value in scores.items() if name in NAMES]


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
            scores.append(
                (CALIBRATION[name], Number(error[name], name.rsplit("_", 1)[1]), "error against the truth of the simulation")
            )
    for name in ("held_out_px", "held_out_mm"):
        if calibration.residuals.get(name) is not None:
            value = Number(calibration.residuals[name], name.rsplit("_", 1)[1])
            scores.append((CALIBRATION[name], value, "root mean square, each view predicted from the others"))
    return scores


def _headline(run: Run, result: dict[str, Any]) -> tuple[list[tuple[str, Number]], str]:
    """The result at a glance, and on what it was measured."""
    labels = {
        "psnr": "PSNR",
        "ssim": "SSIM",
        "normal_mae_alpha_acc_deg": "normals, mean error",
        "depth_median_mm": "depth, median error",
    }
    shown = [(label, Number(result["mean"][name], unit(name), digits=3 if name == "ssim" else 2))
             for name, label in labels.items() if result["mean"].get(name) is not None]  # fmt: skip
    if result.get("mesh"):
        shown.append((NAMES["chamfer_mm"], Number(result["mesh"]["chamfer_mm"], "mm", digits=2)))
    log = run.log()
    trained = f", after {log[-1]['seconds']:.0f} s of training ({log[-1]['step']} steps)" if log else ""
    return shown, f"on {result['views']} {result['split']} views at {result['size'][0]}×{result['size'][1]}{trained}"


def _curve(run: Run) -> str | None:
    """PSNR over the seconds of training, as SVG in colours for light and dark; None where the log is too short."""
    from datasets.reports.drawing import COLOURS, blank, svg_of

    log = run.log()
    if len(log) < 2:
        return None
    drawing = blank(8, 3.2)
    axes = drawing.add_subplot()
    for key, label, colour in (
        ("psnr_unseen", "unseen views", COLOURS[0]),
        ("psnr_train", "training rays (last batch)", COLOURS[1]),
    ):
        points = [(line["seconds"], line[key]) for line in log if key in line]
        if points:
            axes.plot(*zip(*points, strict=True), label=label, color=colour, linewidth=2 if key == "psnr_unseen" else 1.2)
    axes.set(xlabel="seconds of training", ylabel="PSNR [dB]")
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, loc="lower right")
    return svg_of(drawing)


def _work(run: Run, result: dict[str, Any]) -> list[str]:
    """What the training did and what it could leave out, a sentence each."""
    log, content = run.log(), run.content
    facts = [
        f"preset {run.config.preset}, model {run.config.model}, sampler {run.config.sampler.kind}, on {content.get('device', 'unknown device')}"
    ]
    if log and "occupied" in log[-1]:
        facts.append(f"{100 * log[-1]['occupied']:.0f} % of the space holds anything at the end; the rest is left out")
    if log and log[-1]["skipped"]:
        facts.append(f"{log[-1]['skipped']} of {log[-1]['step']} steps were left out because their gradient was not finite")
    if refined := poses.summary(run.path):
        facts.append(refined)
    if "aligned" in result:
        facts.append(f"with each view's pose aligned by itself to the model, PSNR is {result['aligned']['mean']['psnr']:.2f} dB")
    facts.append(f"{result['mean']['seconds']:.2f} s per rendered view, all channels and density normals included")
    return [*facts, *(str(note) for note in content.get("notes", []))]


def _commands(run: Run, result: dict[str, Any], out: Path, calibration: Path | None) -> list[str]:
    """Command lines that lead to the report, the last of which makes it."""
    path = run.path
    budget = run.content.get("budget_s")
    scale = f" --set scale={run.config.scale:g}" if run.config.scale != 1 else ""
    train = f"reconstruct train {run.scene_path} --model {run.config.model} --preset {run.config.preset}{scale}"
    if "from" in run.content:
        train = f"reconstruct train --from {run.content['from']} --finetune"
    stands_on = f" --stands-on {side}" if (side := result.get("mesh_stands_on")) else ""
    aligned = " --align" if "aligned" in result else ""
    lines = [f"{train}{f' --budget {budget:g}' if budget else ''} --out {path}", f"reconstruct eval {path}{stands_on}{aligned}"]
    return [*lines, f"reconstruct report {path}{f' --calibration {calibration}' if calibration else ''} --out {out}"]
