"""Measure a run on views that it was not trained on: renders each, compares it with the truth, averages.

RUN/metrics.json    each figure per view and on average, what it means, and the time per view
"""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.camera_model import Camera
from datasets.core import files
from datasets.core.console import progress
from datasets.formats import find
from datasets.imaging import images
from datasets.scene import View
from reconstruct.errors import ReconstructError
from reconstruct.output import metric_names, metrics
from reconstruct.output.align import Aligner
from reconstruct.output.lpips import Lpips
from reconstruct.output.mesh import extraction, surface_distance
from reconstruct.output.trained_model import TrainedModel
from reconstruct.scene import poses
from reconstruct.scene.rays import over, read_scaled

FORMAT, VERSION = "koala-metrics", 1
METRICS = "metrics.json"
ALIGNED = {
    "aligned": "figures of the same views after each one's pose was aligned by itself to the model, which stayed as it was; neither the training nor "
               "any other figure knows of it, and the pixels that decided are measured with the others",
    "pixels": "pixels of the view that decided its pose, drawn at random",
    "steps": "steps of Levenberg's and Marquardt's method",
}  # fmt: skip
"""What figures of aligned views are."""
ALIGNED_SHOWN = ("psnr", "ssim", "lpips")
"""Those of them that a person is shown."""
TRUE_SURFACE = "truth/object.ply"
"""Where a simulated scene keeps the object's true mesh [m]."""


def evaluate(
    trained: TrainedModel, *, split: str = "test", lpips: Lpips | None = None, align: bool = False, stands_on: str | None = None
) -> dict[str, Any]:
    """Measure a trained model on the views of one split and write `metrics.json` into its run.

    Args:
        lpips: measure the perceptual distance too.
        align: beside the figures of the views as they are, those after each view's pose was aligned to the model.
        stands_on: measure the mesh of what stands on this side of the box, see `extraction.extract`.

    Raises:
        UsageError: its scene has no such views.
    """
    views = trained.scene.split(split)
    start = time.perf_counter()
    trained.warm_up(views[0])
    compilation_s = time.perf_counter() - start
    measured = _measured(trained, views, lpips)
    result = {
        "format": FORMAT, "version": VERSION, "split": split, "views": len(measured), "scale": trained.run.config.scale,
        "size": [trained.camera(views[0]).width, trained.camera(views[0]).height], "steps": int(trained.state.step),
        "mean": mean(measured), "per_view": measured, "compilation_s": compilation_s, "definitions": definitions(),
        **source_of(lpips),
    }  # fmt: skip
    if align:
        result |= {"aligned": _aligned(trained, views, lpips)}
    truth_mesh = find(trained.run.scene_path) / TRUE_SURFACE
    if truth_mesh.is_file() and trained.scene.metric:
        result |= {"mesh": compare_surface(trained, truth_mesh, stands_on), "mesh_stands_on": stands_on,
                   "mesh_definitions": surface_distance.DEFINITIONS}  # fmt: skip
    files.write_json(trained.run.path / METRICS, result)
    return result


def _measured(trained: TrainedModel, views: Sequence[View], lpips: Lpips | None) -> list[dict[str, Any]]:
    """Figures of each view as it is rendered from its pose."""
    measured: list[dict[str, Any]] = []
    with progress("evaluating", len(views), "views") as shown:
        for view in views:
            start = time.perf_counter()
            picture = trained.picture(view)
            seconds = time.perf_counter() - start
            truth = read_truth(view, trained.camera(view))
            found = compare(vars(picture), truth, metric=trained.scene.metric, lpips=lpips)
            measured.append({"name": view.name, **found, "seconds": seconds})
            shown.advance()
            shown.note(f"PSNR {measured[-1]['psnr']:.1f} dB")
    return measured


def _aligned(trained: TrainedModel, views: Sequence[View], lpips: Lpips | None) -> dict[str, Any]:
    """The same after each view's pose was aligned by itself, how far that moved it, and what that means."""
    aligner, found = Aligner(trained), []
    with progress("aligning", len(views), "views") as shown:
        for view in views:
            found.append(aligner(view))
            shown.advance()
    measured = _measured(trained, [one.view for one in found], lpips)
    moved = [poses.change(view, one.view, trained.scene.box) for view, one in zip(views, found, strict=True)]
    per_view = [{**figures, **size, "pixels": one.pixels, "steps": one.steps}
                for figures, size, one in zip(measured, moved, found, strict=True)]  # fmt: skip
    return {"mean": mean(measured), "per_view": per_view, "definitions": ALIGNED | poses.DEFINITIONS}


def compare_surface(trained: TrainedModel, truth: Path, stands_on: str | None = None) -> dict[str, float] | None:
    """Distance of the model's surface, see `extraction.extract`, from a true mesh [m], see `surface_distance`; None where it has none."""
    import trimesh

    try:
        surface = extraction.extract(trained, stands_on=stands_on)
    except ReconstructError:
        return None
    return surface_distance.compare(surface, trimesh.load_mesh(truth), trained.scene.views, trained.scene.box)


def read_truth(view: View, camera: Camera) -> dict[str, NDArray[np.float32]]:
    """All truth maps of a view at the size of `camera`, and "rgb": its picture in sRGB, over white where it has an alpha.

    Each new pixel is the mean of what it covers: normals as vectors, then brought to unit length; depth over those pixels
    that have one. "alpha" is there wherever it can be known: from the truth, the picture's own, or where a depth is given.
    """
    scale = camera.width / view.camera.width
    picture = read_scaled(view, scale)
    maps = {"rgb": over(picture)}
    if picture.shape[-1] == 4:
        maps["alpha"] = picture[..., 3:]
    for channel in view.truth:
        maps[channel] = _resampled(channel, view.read_truth(channel), camera)
    if "alpha" not in maps and "depth" in maps:
        maps["alpha"] = (maps["depth"] > 0).astype(np.float32)
    return maps


def _resampled(channel: str, values: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    if channel == "depth":
        known = (values[..., :1] > 0).astype(np.float32)
        share = images.resize(known, camera.width, camera.height, srgb=False)
        return images.resize(values[..., :1] * known, camera.width, camera.height, srgb=False) / np.maximum(share, 1e-6)
    small = images.resize(values, camera.width, camera.height, srgb=False)
    if channel == "alpha":
        return small[..., :1]
    if channel == "normals":
        length = np.linalg.norm(small, axis=-1, keepdims=True)
        return np.where(length > 1e-3, small / np.maximum(length, 1e-3), 0).astype(np.float32)
    return small[..., :3]


def compare(
    shown: Mapping[str, NDArray[np.float32]],
    truth: Mapping[str, NDArray[np.float32]],
    *,
    metric: bool,
    lpips: Lpips | None = None,
) -> dict[str, float | None]:
    """Figures of `metrics.DEFINITIONS` for one picture, as far as there is something to compare.

    Args:
        shown: the maps of a `Picture` by name, as many as there are; "rgb" at least.
        truth: from `read_truth`.
        metric: whether depths are in metres.
        lpips: measure the perceptual distance too.
    """
    found: dict[str, float | None] = {
        "psnr": metrics.psnr(shown["rgb"], truth["rgb"]),
        "ssim": metrics.ssim(shown["rgb"], truth["rgb"]),
    }
    if lpips is not None:
        found["lpips"] = lpips(shown["rgb"], truth["rgb"])
    opacity = shown.get("opacity", np.ones_like(truth["rgb"][..., :1]))
    alpha = truth.get("alpha", np.ones_like(opacity))
    for name, channel in {"normal": "normals", "normal_pred": "normals_pred"}.items():
        if "normals" in truth and channel in shown and np.any(shown[channel]):  # a model may predict none
            for ending, weight in {"mae_alpha_acc_deg": alpha * opacity, "mae_deg": alpha}.items():
                found[f"{name}_{ending}"] = metrics.normal_mae_deg(shown[channel], truth["normals"], weight)
    if "depth" in truth and "depth" in shown:
        known = (alpha > 0.5)[..., 0] & (truth["depth"] > 0)[..., 0]
        found["disparity_rmse"] = metrics.disparity_rmse(shown["depth"], truth["depth"], known)
        errors = metrics.depth_errors_mm(shown["depth"], truth["depth"], known) if metric else None
        if errors is not None:
            found["depth_rmse_mm"], found["depth_median_mm"] = errors
    for name in ("diffuse", "specular"):
        if name in truth and name in shown:
            srgb = (images.srgb_from_linear(np.maximum(part, 0)) for part in (shown[name], truth[name]))
            found[f"{name}_psnr"] = metrics.psnr(*srgb, shown=(alpha > 0.5)[..., 0])
    return found


def definitions() -> dict[str, str]:
    """Meaning and unit of each figure of a view, as every file of results has them."""
    return {name: f"{meaning} [{unit or '1'}]" for name, (unit, meaning) in metrics.DEFINITIONS.items()}


def source_of(lpips: Lpips | None) -> dict[str, dict[str, str]]:
    """Where the weights of the perceptual distance are from, for a file of results; nothing where it was not measured."""
    return {} if lpips is None else {"lpips_weights": {"file": lpips.file, "sha256": lpips.sha256}}


def mean(measured: list[dict[str, Any]]) -> dict[str, float | None]:
    """Average of each figure over the views that have it."""
    found: dict[str, float | None] = {}
    for name in metrics.DEFINITIONS:
        values = [view[name] for view in measured if view.get(name) is not None]
        if values:
            found[name] = float(np.mean(values))
    return found


def table(result: dict[str, Any]) -> str:
    """The averages for a person, a line each, with units."""
    trained = f", after {result['steps']} steps" if "steps" in result else ""
    lines = [f"{result['views']} {result['split']} views at {result['size'][0]}x{result['size'][1]}{trained}"]
    figures = [(metric_names.heading(name), name, value) for name, value in result["mean"].items()]
    aligned = result.get("aligned", {}).get("mean", {})
    figures += [
        (f"{metric_names.heading(name)}, each pose aligned", name, aligned[name]) for name in ALIGNED_SHOWN if name in aligned
    ]
    figures += [(metric_names.heading(name), name, value) for name, value in (result.get("mesh") or {}).items()]
    lines += [f"  {heading:<50}{metric_names.rounded(name, value):>8}" for heading, name, value in figures]
    if side := result.get("mesh_stands_on"):
        lines.append(f"  ({metric_names.mesh_note(side)})")
    return "\n".join(lines)
