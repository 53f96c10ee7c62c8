"""Evaluate a run: render each view of a split, compare it with the truth, average.

RUN/metrics.json    metrics per view and on average, their definitions, and the time per view
"""

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.console import progress
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.formats import find
from koala3d.datasets.imaging import images
from koala3d.datasets.imaging.copies import Copies
from koala3d.datasets.scene import TURNED, View
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.output import metric_names, metrics
from koala3d.reconstruct.output.align import Aligner
from koala3d.reconstruct.output.lpips import Lpips
from koala3d.reconstruct.output.mesh import extraction, reading, surface_distance
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.rendering.exposure import across_halves, left_half
from koala3d.reconstruct.scene import poses
from koala3d.reconstruct.scene.rays import over, read_scaled

FORMAT, VERSION = "koala-metrics", 1
METRICS = "metrics.json"
ALIGNED = {
    "aligned": "metrics of the same views after the pose of each was aligned to the fixed model; training and all other metrics "
    "use the original poses; pixels used for the alignment are included",
    "pixels": "number of pixels used for the alignment, drawn at random",
    "steps": "steps of the method of Levenberg and Marquardt",
}
"""Definitions for aligned views."""
EXPOSED = {
    "exposure": "training views have learned gains, so each view's gain in linear light was fitted by least squares on one half "
    "of its picture and applied to the other, both ways; all metrics of the colour are of the two halves together",
    "log_gains": "natural logarithms of the gains fitted on the left half and on the right",
    "psnr_as_rendered": "psnr without them: at the mean exposure of the training views [dB]",
}
"""Definitions for models with gains."""
ALIGNED_SHOWN = ("psnr", "ssim", "psnr_inside", "ssim_inside", "lpips")  # metrics of aligned views in the summary
OF_OTHERS = ("asset",)
"""Keys of metrics.json that other commands add: kept when the same state of a run is evaluated again."""
TRUE_SURFACE = "truth/object.ply"  # true mesh [m] of the object in a simulated scene


def evaluate(
    trained: TrainedModel, *, split: str = "test", lpips: Lpips | None = None, align: bool = False, stands_on: str | None = None
) -> dict[str, Any]:
    """Evaluate a trained model on the views of one split and write `metrics.json` into its run.

    Args:
        lpips: also compute the perceptual distance.
        align: also evaluate after aligning the pose of each view to the model.
        stands_on: side of the box that the object stands on, for its mesh, see `extraction.extract`.

    Raises UsageError: the scene has no such views.
    """
    views = trained.scene.split(split)
    start = time.perf_counter()
    trained.warm_up(views[0])
    compilation_s = time.perf_counter() - start
    measured = _measured(trained, views, lpips)
    camera, steps = trained.camera(views[0]), trained.step
    result = summary(split, measured, [camera.width, camera.height], lpips)
    if trained.model.per_image is not None:
        as_rendered = float(np.mean([view["psnr_as_rendered"] for view in measured]))
        result |= {"exposure": {"psnr_as_rendered": as_rendered, "definitions": EXPOSED}}
    result |= {"scale": trained.run.config.scale, "steps": steps, "compilation_s": compilation_s}
    if align:
        result |= {"aligned": _aligned(trained, views, lpips)}
    truth_mesh = find(trained.run.scene_path) / TRUE_SURFACE
    if truth_mesh.is_file() and trained.scene.metric:
        result |= {"mesh": compare_surface(trained, truth_mesh, stands_on), "mesh_stands_on": stands_on}
        result |= {"mesh_definitions": surface_distance.DEFINITIONS}
    with suppress(KoalaError):  # a file that cannot be read is replaced
        result |= {name: values for name, values in _stored(trained).items() if name in OF_OTHERS}
    files.write_json(trained.run.path / METRICS, result)
    return result


def current(trained: TrainedModel) -> dict[str, Any]:
    """The run's metrics if they belong to this state of it; otherwise new ones."""
    return _stored(trained) or evaluate(trained)


def _stored(trained: TrainedModel) -> dict[str, Any]:
    """The run's metrics.json if it belongs to this state of it; otherwise nothing."""
    path = trained.run.path / METRICS
    result = files.read_json(path, kind=FORMAT, version=VERSION) if path.is_file() else {}
    return result if result.get("steps") == trained.step else {}


def _measured(trained: TrainedModel, views: Sequence[View], lpips: Lpips | None) -> list[dict[str, Any]]:
    """Metrics of each view."""
    measured: list[dict[str, Any]] = []
    with progress("evaluating", len(views), "views") as shown:
        for view in views:
            start = time.perf_counter()
            picture = trained.picture(view)
            seconds = time.perf_counter() - start
            truth = read_truth(view, trained.camera(view), trained.run.copies)
            maps, exposure = _exposed(trained, vars(picture), truth["rgb"])
            found = compare(maps, truth, metric=trained.scene.metric, lpips=lpips)
            measured.append({"name": view.name, **found, **exposure, "seconds": seconds})
            shown.advance()
            shown.note(f"PSNR {measured[-1]['psnr']:.1f} dB")
    return measured


def _exposed(
    trained: TrainedModel, maps: dict[str, NDArray[np.float32]], truth: NDArray[np.float32]
) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """The maps of a view with its exposure, where the model has gains, and what was fitted; see `EXPOSED`."""
    gains = trained.model.per_image
    if gains is None:
        return maps, {}
    height, width = truth.shape[:2]
    rgb, fits = across_halves(maps, truth, left_half(height, width), trained.renderer.behind[0], gains.shape[1])
    return maps | {"rgb": rgb}, {"psnr_as_rendered": metrics.psnr(maps["rgb"], truth), "log_gains": fits}


def _aligned(trained: TrainedModel, views: Sequence[View], lpips: Lpips | None) -> dict[str, Any]:
    """Metrics after aligning the pose of each view, the change of each pose, and definitions."""
    aligner, found = Aligner(trained), []
    with progress("aligning", len(views), "views") as shown:
        for view in views:
            found.append(aligner(view))
            shown.advance()
    measured = _measured(trained, [one.view for one in found], lpips)
    moved = [poses.change(view, one.view, trained.scene.box) for view, one in zip(views, found, strict=True)]
    work = [{"pixels": one.pixels, "steps": one.steps} for one in found]
    per_view = [values | change | one for values, change, one in zip(measured, moved, work, strict=True)]
    return {"mean": mean(measured), "per_view": per_view, "definitions": ALIGNED | poses.DEFINITIONS}


def compare_surface(trained: TrainedModel, truth: Path, stands_on: str | None = None) -> dict[str, float] | None:
    """Distance of the model's surface from a true mesh [m], see `surface_distance`; None if the model has no surface."""
    try:
        surface = extraction.extract(trained, stands_on=stands_on)
    except ReconstructError:
        return None
    scene, true = trained.scene, reading.read(truth, process=True)
    floor = 0.0 if TURNED in scene.provenance else surface_distance.FLOOR
    return surface_distance.compare(surface, true, scene.views, scene.box, floor=floor)


def read_truth(view: View, camera: Camera, copies: Copies | None = None) -> dict[str, NDArray[np.float32]]:
    """All true maps of a view at the size of `camera`, and "rgb": its image in sRGB, over white if it has an alpha.

    Each new pixel is the mean over the pixels it covers; normals are normalised afterwards, depth is averaged where it is known.
    "alpha" comes from the truth, from the image, or from the pixels with a depth. Where it is known, "rgb" shows the whole
    object, and not what is left of it by a mask that was found. `copies`: see `read_scaled`.
    """
    scale = camera.width / view.camera.width
    if view.mask is not None and "alpha" in view.truth:
        view, copies = replace(view, mask=view.truth["alpha"], mask_inverted=False), None
    picture = read_scaled(view, scale, copies)
    maps: dict[str, NDArray[Any]] = {"rgb": over(picture)}
    if (counted := view.counted(camera)) is not None:
        maps["counted"] = counted
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
        total = images.resize(values[..., :1] * known, camera.width, camera.height, srgb=False)
        return (total / np.maximum(share, 1e-6)).astype(np.float32)
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
    """The metrics of `metrics.DEFINITIONS` for one image, as far as both sides have the maps.

    Args:
        shown: the maps of a `Picture` by name; "rgb" is required.
        truth: from `read_truth`; pixels that are not "counted" are taken to be right, and left out of the PSNR.
        metric: whether depths are in metres.
        lpips: also compute the perceptual distance.
    """
    counted, pair = truth.get("counted"), (shown["rgb"], truth["rgb"])
    if counted is not None:
        pair = np.where(counted[..., None], shown["rgb"], truth["rgb"]), truth["rgb"]
    found: dict[str, float | None] = {"psnr": metrics.psnr(*pair, counted), "ssim": metrics.ssim(*pair)}
    if "alpha" in truth:
        inside = metrics.inside(truth["alpha"]) & (True if counted is None else counted)
        found |= {"psnr_inside": metrics.psnr(*pair, inside), "ssim_inside": metrics.ssim(*pair, inside)}
    if lpips is not None:
        found["lpips"] = lpips(*pair)
    opacity = shown.get("opacity", np.ones_like(truth["rgb"][..., :1]))
    alpha = truth.get("alpha", np.ones_like(opacity))
    for name, channel in {"normal": "normals", "normal_pred": "normals_pred"}.items():
        if "normals" in truth and channel in shown and np.any(shown[channel]):  # some models predict none
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


def summary(split: str, measured: list[dict[str, Any]], size: list[int], lpips: Lpips | None) -> dict[str, Any]:
    """The content of a file of results: metrics per view and their means."""
    weights = {} if lpips is None else {"lpips_weights": {"file": lpips.file, "sha256": lpips.sha256}}
    head = {"format": FORMAT, "version": VERSION, "split": split, "views": len(measured), "size": size}
    return {**head, "mean": mean(measured), "per_view": measured, "definitions": definitions(), **weights}


def definitions() -> dict[str, str]:
    """Meaning and unit of each metric of a view, for a file of results."""
    return {name: f"{meaning} [{unit or '1'}]" for name, (unit, meaning) in metrics.DEFINITIONS.items()}


def mean(measured: list[dict[str, Any]]) -> dict[str, float | None]:
    """Mean of each metric over the views that have it."""
    columns = {name: [view[name] for view in measured if view.get(name) is not None] for name in metrics.DEFINITIONS}
    return {name: float(np.mean(values)) for name, values in columns.items() if values}


def table(result: dict[str, Any]) -> str:
    """The means as text, a line each, with units."""
    trained = f", after {result['steps']} steps" if "steps" in result else ""
    lines = [f"{result['views']} {result['split']} views at {result['size'][0]}x{result['size'][1]}{trained}"]
    if "exposure" in result:
        lines.append("  exposure of each view fitted on one half of its picture, measured on the other")
        lines.append(f"  {'PSNR as rendered, without this [dB]':<50}{result['exposure']['psnr_as_rendered']:>8.2f}")
    aligned = {name: value for name, value in result.get("aligned", {}).get("mean", {}).items() if name in ALIGNED_SHOWN}
    blocks = (("", result["mean"]), (", poses aligned", aligned), ("", result.get("mesh") or {}))
    for ending, values in blocks:
        for name, value in values.items():
            lines.append(f"  {metric_names.heading(name) + ending:<50}{metric_names.rounded(name, value):>8}")
    if side := result.get("mesh_stands_on"):
        lines.append(f"  ({metric_names.mesh_note(side)})")
    return "\n".join(lines)
