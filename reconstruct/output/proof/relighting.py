"""An asset in a light that no photograph shows, against the true picture: of scenes under distant light, whose truth is known.

Photographs tell albedo only up to a factor, one for each channel if lamps are coloured. It is fitted by least squares in linear
light over the object in all views together.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from koala3d.datasets.core.console import progress
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import View
from koala3d.reconstruct.output import metrics
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.path_tracing import panorama
from koala3d.reconstruct.path_tracing.reading import StoredAsset
from koala3d.reconstruct.path_tracing.stage import Stage, over_white
from koala3d.reconstruct.rendered.light import Light
from koala3d.reconstruct.rendered.shiny import SCENES
from koala3d.reconstruct.rendered.views import Traced

HEIGHT = 256  # rows of the light's picture
SHARP = 1e6  # concentration of a lobe that leaves the light as it is
DEFINITIONS = {
    "light": "number of the studio's light, which the scene's photographs do not show",
    "gains": "factors on the asset's linear light, fitted over the object in all views together",
    "psnr": "of the asset's pictures with these gains, as above [dB]",
    "psnr_inside": "of the same pictures inside the object less its edge [dB]",
}


@dataclass(frozen=True)
class TrueLight:
    """A scene with a formula in another light."""

    number: int
    light: Light
    views: Traced


def true_light(trained: TrainedModel, number: int) -> TrueLight:
    """Another light of a run's scene. Raises UsageError: the scene's truth is not known."""
    name = trained.scene.name
    if name not in SCENES:
        why = f"'{name}' is none of {', '.join(SCENES)}"
        raise UsageError("the scene cannot be shown in another light", where=trained.run.scene_path, why=why)
    light = Light.studio(number)
    return TrueLight(number, light, Traced(replace(SCENES[name](), light=light)))


def measure(
    trained: TrainedModel,
    asset: StoredAsset,
    lit: TrueLight,
    views: tuple[View, ...],
    *,
    paths: int,
    out: Path | None,
    using: str,
) -> dict[str, Any]:
    """The figures of `DEFINITIONS`; `out`: folder for a picture of each view: truth, asset."""
    towards = panorama.directions(asset.base_from_asset, HEIGHT).reshape(-1, 3)
    radiance = np.asarray(lit.light.convolved(towards.T.astype(np.float32), SHARP)).T.reshape(HEIGHT, 2 * HEIGHT, 3)
    stage, pairs = Stage(asset, radiance, using=using), []
    with progress("relighting", len(views), "views") as bar:
        for seed, view in enumerate(views):
            camera = trained.camera(view)
            maps = lit.views.maps(camera, view.world_from_camera)
            straight = (maps["diffuse"] + maps["specular"]) / np.maximum(maps["alpha"], 1e-3)
            truth = np.concatenate([straight, maps["alpha"]], -1)
            pairs.append((truth, stage.picture(view, camera, paths=paths, seed=seed)))
            bar.advance()
    gains = fitted(pairs)
    measured = []
    for view, (truth, found) in zip(views, pairs, strict=True):
        true, shown = over_white(truth), over_white(found * np.append(gains, 1))
        measured.append((metrics.psnr(shown, true), metrics.psnr(shown, true, metrics.inside(truth[..., 3:]))))
        if out is not None:
            images.write(out / f"{view.name}_relit.png", np.concatenate([true, shown], 1))
    psnr, inside = (float(np.mean([value for value in column if value is not None])) for column in zip(*measured, strict=True))
    about = {"light": lit.number, "gains": gains.tolist(), "psnr": psnr, "psnr_inside": inside}
    return about | {"definitions": DEFINITIONS}


def fitted(pairs: list[tuple[Float[np.ndarray, "h w 4"], Float[np.ndarray, "h w 4"]]]) -> Float[np.ndarray, " 3"]:
    """Factors of the second pictures' colours by least squares to the first's, where the first are below white."""
    products, squares = np.zeros(3), np.zeros(3)
    for truth, found in pairs:
        both = (truth[..., 3] > 0.99) & (found[..., 3] > 0.99) & (truth[..., :3].max(-1) < 1)
        products += np.sum(truth[both][:, :3] * found[both][:, :3], 0)
        squares += np.sum(found[both][:, :3] ** 2, 0)
    return products / np.maximum(squares, 1e-12)
