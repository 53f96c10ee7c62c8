"""Which formats an asset is written in, and what is said of it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.datasets.core import files
from koala3d.reconstruct.asset.asset import Asset
from koala3d.reconstruct.asset.writing import glb, obj, usd

WRITERS: dict[str, Callable[[Asset, Path], None]] = {
    ".glb": glb.save,
    ".obj": obj.save,
    ".usd": usd.save,
    ".usdz": usd.save_packed,
}


def writer(path: Path) -> Callable[[Asset, Path], None]:
    """Writes the format that a suffix names. Raises UsageError: none."""
    return WRITERS[files.required_suffix(path, "assets", WRITERS)]


def summary(asset: Asset) -> tuple[dict[str, Any], str]:
    """Sizes and certainty, for a program and for a person."""
    size, certainty = np.ptp(asset.mesh.vertices, axis=0).tolist(), asset.about["certainty"]
    counts = {"vertices": len(asset.mesh.vertices), "faces": len(asset.mesh.faces)}
    result = {**counts, "size": size, "base_from_asset": asset.base_from_asset.tolist(), "metric": asset.metric, **asset.about}
    unit = "m" if asset.metric else "units"
    return result, "\n".join(
        [
            f"{counts['faces']} triangles, {' x '.join(f'{side:.3f}' for side in size)} {unit}, y up",
            f"{certainty['seen_by_3_views']:.0%} of the surface is seen by three views or more, "
            f"{certainty['unseen']:.0%} by none",
            f"{asset.about['specular_unexplained']:.1%} of the mirrored light's energy is not explained by material and light",
        ]
    )
