"""Which formats splats are written in, and what is said of them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from koala3d.datasets.core import files
from koala3d.reconstruct.splats.splats import Splats
from koala3d.reconstruct.splats.writing import gltf, ply, spz, usd

WRITERS: dict[str, Callable[[Splats, Path], None]] = {
    ".ply": ply.save,
    ".spz": spz.save,
    ".glb": gltf.save,
    ".usd": usd.save,
}


def writer(path: Path) -> Callable[[Splats, Path], None]:
    """Writes the format that a suffix names. Raises UsageError: none."""
    return WRITERS[files.required_suffix(path, "splats", WRITERS)]


def summary(splats: Splats) -> tuple[dict[str, Any], str]:
    """Number and size, for a program and for a person."""
    unit, spacing = "m" if splats.metric else "units", 2 * float(splats.scales[:, 0].mean())
    result = {"splats": len(splats.points), "spacing": spacing, "metric": splats.metric, **splats.about}
    lines = [
        f"{len(splats.points)} splats, {spacing:.2g} {unit} apart, in the world of the scene",
        f"the model shows {splats.about['seen']:.0%} of them to cameras; the others have the colours of the nearest ones",
    ]
    if splats.about["surroundings"] == "left out":
        lines.append("surroundings are left out: splats show the object only")
    return result, "\n".join(lines)
