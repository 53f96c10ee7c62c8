"""The mean piece: where pieces that are compared with the same surface lie on average, and how much each differs from that.

OUT/mean/NAME.ply     that surface moved by the mean deviation; vertices have `mean`, `spread` [m] and `known`
OUT/mean/NAME.json    the pieces, and how far each is from the mean
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from koala3d.datasets.core import files
from koala3d.reconstruct.series.plan import COMPARE, MESH, Piece

FORMAT, VERSION, FOLDER = "koala-series-mean", 1, "mean"
FEWEST = 3
"""Pieces that have a mean, the one that the others are compared with included."""


@dataclass(frozen=True)
class Kind:
    """Pieces that are compared with one surface."""

    name: str
    surface: Path
    """Its mesh."""
    reference: str | None
    """The object that it is of; None for a drawing."""
    compared: Mapping[str, Path]
    """Folder of each comparison that is done, by the piece's name."""

    @property
    def pieces(self) -> list[str]:
        """Their names."""
        return [*([self.reference] if self.reference is not None else []), *self.compared]

    @property
    def about(self) -> str:
        """Name of the file about their mean, in the folder of the series."""
        return f"{FOLDER}/{self.name}.json"


def kinds(pieces: Mapping[str, Piece]) -> list[Kind]:
    """Those that have a mean: `FEWEST` pieces or more, and a mesh of what they are compared with."""
    groups: dict[Path, dict[str, Path]] = {}
    for name, piece in pieces.items():
        if any(step.kind == "compare" and step.done for step in piece.steps):
            of = piece.item.drawing if piece.reference is None else pieces[piece.reference].place / MESH
            if of is not None and of.is_file():
                groups.setdefault(of, {})[name] = piece.place / COMPARE
    found = []
    for surface, compared in groups.items():
        reference = next((name for name in pieces if pieces[name].place / MESH == surface), None)
        name = reference or f"{surface.stem}_of_{next(iter(compared))}"  # many drawings may be called alike
        found.append(Kind(name, surface, reference, compared))
    return [kind for kind in found if len(kind.pieces) >= FEWEST]


def write(kind: Kind, out: Path) -> None:
    """Write the mean of some pieces, unless it is there."""
    if read(kind, out):
        return
    from koala3d.reconstruct.output.mesh import files as mesh_files
    from koala3d.reconstruct.output.shape import stated
    from koala3d.reconstruct.output.shape.places import vertex_areas

    surface = stated.finer(stated.read(kind.surface)).mesh
    away = {name: _deviation(folder, np.asarray(surface.vertices)) for name, folder in kind.compared.items()}
    known = np.all([there for _, there in away.values()], axis=0)
    deviations = {name: distance for name, (distance, _) in away.items()}
    if kind.reference is not None:
        deviations[kind.reference] = np.zeros(len(known))
    together = np.where(known, np.stack(list(deviations.values())), 0)
    mean, spread, areas = together.mean(0), together.std(0), np.where(known, vertex_areas(surface), 0)
    share = areas / max(areas.sum(), 1e-30)
    rms = {name: float(np.sqrt(share @ (one - mean) ** 2)) for name, one in zip(deviations, together, strict=True)}
    surface.vertices = surface.vertices + mean[:, None] * np.asarray(surface.vertex_normals)
    properties = {"mean": mean, "spread": spread, "known": known}
    surface.vertex_attributes.update({key: np.asarray(values, np.float32) for key, values in properties.items()})
    about = out / kind.about
    files.make_folder(about.parent)
    mesh_files.save(surface, about.with_suffix(".ply"))
    content: dict[str, Any] = {"pieces": kind.pieces, "from_mean_rms_m": rms, "known_share": float(np.mean(known))}
    files.write_json(about, {"format": FORMAT, "version": VERSION, **content})


def read(kind: Kind, out: Path) -> dict[str, float]:
    """How far each piece is from the mean (RMS) [m], by its name; empty where the mean is not there, or is of other pieces."""
    if not (out / kind.about).is_file():
        return {}
    found = files.read_json(out / kind.about, kind=FORMAT, version=VERSION)
    return found["from_mean_rms_m"] if found["pieces"] == kind.pieces else {}


def _deviation(folder: Path, places: Float[np.ndarray, "v 3"]) -> tuple[Float[np.ndarray, " v"], Any]:
    """A piece's distance from the surface at places of that surface [m], and where it is compared."""
    from koala3d.reconstruct.output.mesh import reading
    from koala3d.reconstruct.output.mesh.nearest import Nearest
    from koala3d.reconstruct.output.shape import files as shape_files

    mesh = reading.read(folder / shape_files.MESH)
    vertices = mesh.metadata["_ply_raw"]["vertex"]["data"]
    near = Nearest(mesh)
    feet = near.feet(places)
    values = np.stack([np.asarray(vertices[name], float).ravel() for name in (shape_files.DISTANCE, shape_files.COMPARED)], -1)
    distance, compared = near.at(feet, values).T
    return distance, (compared > 0.5) & ~near.on_an_edge(feet)
