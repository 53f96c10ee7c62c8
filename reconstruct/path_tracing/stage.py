"""An asset on Mitsuba's stage, seen through the cameras of a scene."""

import importlib.util
from pathlib import Path

import numpy as np
from jaxtyping import Float

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.mitsuba_variant import variant
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import View
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.path_tracing import lens
from koala3d.reconstruct.path_tracing.reading import StoredAsset

TRIAL = "koala3d.reconstruct.path_tracing.trial"
"""Module that tries a variant of Mitsuba."""


class Stage:
    """An asset in a light, to be looked at by the views of a scene."""

    def __init__(self, asset: StoredAsset, light: Path | Float[np.ndarray, "h w 3"], *, using: str | None = None) -> None:
        """Load it under a light, from a file or an array of that kind.

        Args:
            using: a variant of Mitsuba; None: the fastest that works.

        Raises DatasetError: the light cannot be read. ReconstructError: Mitsuba is missing.
        """
        self._asset_from_world = np.linalg.inv(asset.base_from_asset)
        if isinstance(light, Path):
            images.read(light)  # says what is wrong with it better than the renderer
        require_mitsuba()
        self.using = using or variant(TRIAL)  # before Mitsuba is imported, which loads LLVM
        from koala3d.reconstruct.path_tracing.renderer import Renderer

        self._renderer = Renderer(asset, light, using=self.using)

    def turn_light(self, angle: float) -> None:
        """Turn the light about the asset's upward axis, counterclockwise seen from above, from how it was loaded [rad]."""
        self._renderer.turn_light(angle)

    def picture(self, view: View, camera: Camera, *, paths: int, seed: int) -> Float[np.ndarray, "h w 4"]:
        """Straight linear light and alpha of a view."""
        pinhole = lens.pinhole_for(camera)
        place = self._asset_from_world @ view.world_from_camera
        linear = lens.through(camera, pinhole, self._renderer.picture(pinhole, place, paths=paths, seed=seed))
        alpha = np.clip(linear[..., 3:], 0, 1)
        light = linear[..., :3] / np.maximum(alpha, 0.5 / paths)
        return np.concatenate([np.maximum(light, 0), alpha], -1)


def require_mitsuba() -> None:
    """Raise ReconstructError where Mitsuba is missing."""
    if importlib.util.find_spec("mitsuba") is None:
        raise ReconstructError("assets are rendered by Mitsuba, which is missing", remedy="pip install 'koala-capture[sim]'")


def over_white(picture: Float[np.ndarray, "h w 4"]) -> Float[np.ndarray, "h w 3"]:
    """sRGB in 0..1 of straight linear light, over white as photographs with an alpha are."""
    return np.clip(images.srgb_from_linear(picture[..., :3]), 0, 1) * picture[..., 3:] + (1 - picture[..., 3:])
