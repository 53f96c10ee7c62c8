"""An asset under its light, rendered by Mitsuba from the run's views, beside the photographs and the model's own pictures."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from koala3d.datasets.core import files
from koala3d.datasets.core.console import progress
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import View
from koala3d.reconstruct.output import metrics
from koala3d.reconstruct.output.evaluate import METRICS, current, read_truth
from koala3d.reconstruct.output.proof import relighting
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.path_tracing import reading
from koala3d.reconstruct.path_tracing.stage import Stage, over_white

KEY = "asset"
"""Of the figures in metrics.json."""
PATHS = 64
"""Default light paths per pixel."""
DEFINITIONS = {
    "psnr": "of the asset's picture over white; absent where photographs show surroundings, of which the asset has none [dB]",
    "psnr_inside": "of the same picture inside the object less its edge, as in the metrics above; where photographs have no "
    "alpha, inside what the asset covers [dB]",
    "model_psnr": "of the model's own picture over the same pixels as psnr [dB]",
    "model_psnr_inside": "of the model's own picture over the same pixels as psnr_inside [dB]",
    "coverage_iou": "overlap of what the asset covers with the object's mask: intersection over union [1]",
}


@dataclass(frozen=True)
class Shown:
    """A view: its photograph, the model's picture and the asset's, sRGB in 0..1, and the metrics of `DEFINITIONS`."""

    name: str
    photograph: Float[np.ndarray, "h w 3"]
    model: Float[np.ndarray, "h w 3"]
    asset: Float[np.ndarray, "h w 3"]
    metrics: dict[str, float | None]


def prove(
    trained: TrainedModel,
    asset: Path,
    light: Path,
    *,
    split: str = "test",
    paths: int = PATHS,
    out: Path | None = None,
    relit: int | None = None,
    using: str | None = None,
) -> dict[str, Any]:
    """Render an asset from the views of a split, compare with the photographs, and add the figures to the run's metrics.json.

    Args:
        asset: a GLB that `reconstruct asset` wrote of this run.
        light: the EXR that `reconstruct light` wrote.
        paths: light paths per pixel.
        out: folder for a picture of each view: photograph, model, asset.
        relit: number of another light, see `relighting`, for scenes that `reconstruct scenes` made.
        using: see `Stage`.
    """
    stored, views = reading.read(asset), trained.scene.split(split)
    lit = None if relit is None else relighting.true_light(trained, relit)
    stage, found = Stage(stored, light, using=using), current(trained)
    measured = []
    with progress("rendering", len(views), "views") as bar:
        for seed, view in enumerate(views):
            one = shown(trained, stage, view, paths=paths, seed=seed)
            if out is not None:
                images.write(out / f"{view.name}.png", np.concatenate([one.photograph, one.model, one.asset], 1))
            measured.append({"name": one.name, **one.metrics})
            bar.advance()
    result = {
        "split": split,
        "views": len(views),
        "steps": trained.step,
        "renderer": f"Mitsuba, {stage.using}",
        "paths": paths,
        "files": {"asset": str(asset), "light": str(light)},
        "mean": _mean(measured),
        "per_view": measured,
        "definitions": DEFINITIONS,
    }
    if lit is not None:
        result |= {"relit": relighting.measure(trained, stored, lit, views, paths=paths, out=out, using=stage.using)}
    files.write_json(trained.run.path / METRICS, found | {KEY: result})
    return result


def shown(trained: TrainedModel, stage: Stage, view: View, *, paths: int, seed: int) -> Shown:
    """A view of a run as the photograph, the model and the asset show it."""
    camera = trained.camera(view)
    truth, model = read_truth(view, camera, trained.run.copies), trained.picture(view).rgb
    picture = stage.picture(view, camera, paths=paths, seed=seed)
    white, covered = over_white(picture), picture[..., 3:]
    has_mask = "alpha" in truth
    alone = has_mask and trained.run.normalisation.bounded  # the photograph shows nothing but the object
    mask = truth["alpha"] if has_mask else covered
    inside, photograph = metrics.inside(mask), truth["rgb"]
    both, either = np.sum((mask > 0.5) & (covered > 0.5)), np.sum((mask > 0.5) | (covered > 0.5))
    found = {
        "psnr": metrics.psnr(white, photograph) if alone else None,
        "psnr_inside": metrics.psnr(white, photograph, inside),
        "model_psnr": metrics.psnr(model, photograph) if alone else None,
        "model_psnr_inside": metrics.psnr(model, photograph, inside),
        "coverage_iou": float(both / either) if has_mask and either else None,
    }
    return Shown(view.name, photograph, model, white, found)


def _mean(measured: list[dict[str, Any]]) -> dict[str, float]:
    """Mean of each metric over the views that have it."""
    columns = {name: [view[name] for view in measured if view[name] is not None] for name in DEFINITIONS}
    return {name: float(np.mean(values)) for name, values in columns.items() if values}


def text(result: dict[str, Any]) -> str:
    """The means for a person."""
    mean = result["mean"]
    lines = [f"{result['views']} {result['split']} views, {result['renderer']}, {result['paths']} paths per pixel"]
    for name, title in {"psnr": "PSNR [dB]", "psnr_inside": "PSNR inside [dB]"}.items():
        if name in mean:
            lines.append(f"  {title:<20} asset {mean[name]:6.2f}   model {mean[f'model_{name}']:6.2f}")
    if "coverage_iou" in mean:
        lines.append(f"  {'outline, overlap':<20} asset {mean['coverage_iou']:6.3f}")
    if "relit" in result:
        lines.append(f"  {'relit, inside [dB]':<20} asset {result['relit']['psnr_inside']:6.2f}")
    return "\n".join(lines)
