"""Wavefront OBJ with its material (MTL with the PBR extension that viewers share) and textures beside it.

FILE.obj, FILE.mtl, FILE_base_colour.png, FILE_roughness.png, FILE_metallic.png, FILE_normal.png, FILE_occlusion.png,
FILE_certainty.png and FILE_frame.json; the OBJ is written last, so that what it refers to is there.
"""

from pathlib import Path

import numpy as np

from koala3d.datasets.core import files
from koala3d.reconstruct.asset.asset import Asset
from koala3d.reconstruct.asset.certainty import MEANING
from koala3d.reconstruct.asset.writing.png import encoded

FORMAT, VERSION = "koala-asset-frame", 1


def save(asset: Asset, path: Path) -> None:
    """Write an asset as FILE.obj and what it refers to."""
    mesh, stem = asset.mesh, path.stem
    names = write_textures(asset, path.parent, stem)
    material = [
        "newmtl surface",
        "Kd 1 1 1",
        f"map_Kd {names['base_colour']}",
        f"map_Pr {names['roughness']}",
        f"map_Pm {names['metallic']}",
        f"norm {names['normal']}",
    ]
    files.write_text(path.with_name(f"{stem}.mtl"), "\n".join(material) + "\n")
    frame = {"format": FORMAT, "version": VERSION, "base_from_asset": asset.base_from_asset, "metric": asset.metric}
    files.write_json(path.with_name(f"{stem}_frame.json"), frame | {"certainty": MEANING} | asset.about)
    numbers = mesh.faces + 1
    rows = [f"mtllib {stem}.mtl", "o object", "usemtl surface"]
    for key, values in (("v", mesh.vertices), ("vt", mesh.uv), ("vn", mesh.normals)):
        rows += [f"{key} {' '.join(f'{value:.7g}' for value in row)}" for row in values]
    rows += [f"f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}" for a, b, c in numbers.tolist()]
    files.write_text(path, "\n".join(rows) + "\n")


def write_textures(asset: Asset, folder: Path, stem: str) -> dict[str, str]:
    """Write the textures, channels that glTF packs into one file apart; their file names."""
    found, three = asset.textures, lambda values: np.repeat(values[..., None], 3, -1)
    pictures = {
        "base_colour": found.base_colour,
        "occlusion": three(found.surface[..., 0]),
        "roughness": three(found.surface[..., 1]),
        "metallic": three(found.surface[..., 2]),
        "normal": found.normal,
        "certainty": found.certainty,
    }
    if found.specular is not None:
        pictures["specular"] = found.specular
    names = {name: f"{stem}_{name}.png" for name in pictures}
    for name, picture in pictures.items():
        files.write_bytes(folder / names[name], encoded(picture))
    return names
