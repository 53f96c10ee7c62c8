"""What a training reads of its scene's pictures before it starts."""

from koala3d.datasets.core.console import progress
from koala3d.datasets.imaging.copies import Copies
from koala3d.datasets.scene import View
from koala3d.reconstruct.scene.pool import Pool
from koala3d.reconstruct.scene.rays import Normalisation, Pixels


def training_pixels(
    views: tuple[View, ...], normalisation: Normalisation, scale: float, copies: Copies | None = None
) -> tuple[Pixels, Pool | None]:
    """The pixels to draw from, and what renews them where they are only a part of all."""
    pool = Pool(views, normalisation, scale, copies)
    with progress("reading images", len(views), "images") as shown:
        if pool.is_needed:
            return pool.pixels(shown), pool
        return Pixels.load(views, normalisation, scale, shown, copies=copies), None
