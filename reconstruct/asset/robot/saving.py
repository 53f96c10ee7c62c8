"""The folder of a body.

FOLDER/object.urdf       for --robot urdf
FOLDER/object.xml        for --robot mjcf, with scene.xml, in which it stands on a table
FOLDER/visual.obj        the textured mesh, with its material, textures and visual_frame.json
FOLDER/collision_NN.stl  convex parts
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.datasets.core import files
from koala3d.reconstruct.asset.robot import mjcf, urdf
from koala3d.reconstruct.asset.robot.body import Body
from koala3d.reconstruct.asset.writing import obj

VISUAL = "visual"


def save_urdf(body: Body, folder: Path, parts: list[str]) -> None:
    """Write the URDF file."""
    files.write_text(folder / urdf.FILE, urdf.text(body, name_of(body), f"{VISUAL}.obj", parts))


def save_mjcf(body: Body, folder: Path, parts: list[str]) -> None:
    """Write the MJCF file and its scene."""
    textures = {channel: f"{VISUAL}_{channel}.png" for channel in mjcf.LAYERS.values()}
    files.write_text(folder / mjcf.FILE, mjcf.text(body, name_of(body), f"{VISUAL}.obj", parts, textures))
    files.write_text(folder / mjcf.SCENE, mjcf.scene())


WRITERS: dict[str, Callable[[Body, Path, list[str]], None]] = {"urdf": save_urdf, "mjcf": save_mjcf}
"""Writer of each format, by name."""


def save(body: Body, path: Path, kind: str) -> None:
    """Write a new folder, all or nothing. Raises UsageError: it holds something already."""
    with files.atomic_folder(path) as folder:
        obj.save(body.asset, folder / f"{VISUAL}.obj")
        parts = [f"collision_{number:02d}.stl" for number in range(len(body.parts))]
        for name, part in zip(parts, body.parts, strict=True):
            files.write_bytes(folder / name, part.export(file_type="stl"))
        WRITERS[kind](body, folder, parts)


def name_of(body: Body) -> str:
    """The scene's name as simulators take it: letters, digits and underscores."""
    return re.sub(r"\W", "_", body.asset.name, flags=re.ASCII) or "object"


def summary(body: Body) -> tuple[dict[str, Any], str]:
    """Size, mass and stability, for a program and for a person."""
    moments, size = body.inertia, np.ptp(body.asset.mesh.vertices, axis=0)
    result = {
        "faces": len(body.asset.mesh.faces),
        "size": size.tolist(),
        "base_from_asset": body.asset.base_from_asset.tolist(),
        "parts": len(body.parts),
        "mass_kg": moments.mass,
        "volume_m3": moments.volume,
        "centre": moments.centre.tolist(),
        "inertia": moments.tensor.tolist(),
        "measured_in": moments.measured_in,
        "standing_margin_m": body.margin,
        **body.asset.about,
    }
    stands = "it stands" if body.margin > 0 else "it does not stand by itself"
    where = "inside" if body.margin > 0 else "outside"
    return result, "\n".join(
        [
            f"{len(body.asset.mesh.faces)} triangles, {' x '.join(f'{side:.3f}' for side in size)} m, z up, "
            f"{len(body.parts)} convex parts",
            f"{moments.mass:.4g} kg, {1e6 * moments.volume:.4g} cm3 of {moments.measured_in}",
            f"centre of gravity {1e3 * moments.centre[2]:.1f} mm above the table, {abs(1e3 * body.margin):.1f} mm {where} "
            f"the area that carries it: {stands}",
        ]
    )
