"""The light around an object as a picture of all directions: an equirectangular EXR, as renderers and viewers take it.

Its frame is that of `panorama`. Programs that import the asset and the picture have both in one frame, be their own upward axis y
or z.
"""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images
from koala3d.reconstruct.asset import sphere
from koala3d.reconstruct.asset.light import Light
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.path_tracing.panorama import directions

HEIGHT = 256
"""Default number of rows: 0.7 degrees apart, finer than the light is known."""
KNOWN = 0.5  # of `Light.known`, from which on a direction counts as known in summaries


def check(path: Path) -> Path:
    """The path itself. Raises UsageError: it does not end in .exr."""
    if path.suffix.lower() != ".exr":
        raise UsageError(f"light is not written as '{path.suffix}'", where=path, remedy="end the name in .exr")
    return path


def refuse_moving(trained: TrainedModel) -> None:
    """Raise UsageError where the lamps move about the object: one picture shows no such light."""
    frame = trained.run.facts.light
    if frame.moves:
        why = f"they stand still in the frame '{frame.kind}', so each view has another light"
        raise UsageError("the light is not one picture: lamps move about the object", where=trained.run.path, why=why)


def picture(light: Light, base_from_asset: Float[np.ndarray, "4 4"], height: int = HEIGHT) -> Float[np.ndarray, "h w 4"]:
    """Linear radiance from all directions of the asset's frame, and how much of it is known (0..1, see `Light.known`).

    The light is what a perfect mirror would show, as finely as the model's nodes are. Where nothing is known it is a guess from
    the directions around.
    """
    values = np.concatenate([light.radiance, light.known[:, None]], -1)
    towards = directions(base_from_asset, height)
    return sphere.mirrored_at(values, towards.reshape(-1, 3)).reshape(height, 2 * height, 4).astype(np.float32)


def save(light: Light, base_from_asset: Float[np.ndarray, "4 4"], path: Path, *, height: int = HEIGHT) -> None:
    """Write `picture` as an EXR of `height` rows and twice as many columns, with alpha for what is known: it covers nothing."""
    written = picture(light, base_from_asset, height)
    images.write(check(path), written, metadata={"Software": "koala"}, multiplied=False)


def summary(light: Light) -> tuple[dict[str, Any], str]:
    """How much of the light is known and how bright it is, for a program and for a person."""
    known, brightness = float(np.mean(light.known >= KNOWN)), light.radiance.mean(-1)
    result = {"known": known, "mean": float(brightness.mean()), "brightest": float(brightness.max())}
    text = f"{known:.0%} of all directions are known from what the object mirrors"
    return result, f"{text}\nradiance {result['mean']:.2f} on average, {result['brightest']:.1f} where it is brightest"
