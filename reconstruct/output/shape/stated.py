"""A surface with what is known of its errors, from a mesh, a drawing or a run."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from jaxtyping import Bool, Float

from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.reconstruct.output.mesh import reading
from koala3d.reconstruct.run import RUN

if TYPE_CHECKING:
    import trimesh

    from koala3d.reconstruct.output.shape.uncertainty import Uncertain

Unit = Literal["m", "mm", "cm", "in"]
METRES: dict[str, float] = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254}
"""Metres per unit of a file."""
UNITS: tuple[Unit, ...] = get_args(Unit)
DEVIATION, COMMON, OUTLINE, KNOWN = "deviation", "common", "outline", "known"
"""Names of what is known of each vertex's error in PLY files: see `Stated`."""
FINEST = 1 / 100
"""Longest edge of a mesh without stated errors, as a share of its size: deviations are measured at vertices."""


@dataclass(frozen=True)
class Stated:
    """A mesh [m] and the standard deviations of its vertices along their normals [m], where they are stated."""

    name: str
    mesh: "trimesh.Trimesh"
    deviation: Float[np.ndarray, " v"] | None = None
    """What differs from place to place. None: nothing is stated, as in a drawing."""
    common: Float[np.ndarray, " v"] | None = None
    """What moves or scales the whole object: of the calibration. None: not stated."""
    known: Bool[np.ndarray, " v"] | None = None
    """False where nothing is known of the surface. None: known everywhere."""
    outline: Float[np.ndarray, " v"] | None = None
    """What moves all outlines alike: of masks that were found in the pictures. None: not stated."""

    @property
    def size(self) -> float:
        """Diagonal of its box [m]."""
        return float(np.linalg.norm(self.mesh.extents))

    @property
    def variance(self) -> Float[np.ndarray, " f"]:
        """Of each triangle along its normal [m^2]: 0 where nothing is stated, infinite where nothing is known."""
        here = np.zeros(len(self.mesh.vertices)) if self.deviation is None else np.square(self.deviation, dtype=np.float64)
        if self.known is not None:
            here = np.where(self.known, here, np.inf)
        return here[np.asarray(self.mesh.faces)].mean(1)


def read(path: Path, *, unit: Unit = "m", stands_on: str | None = None) -> Stated:
    """The surface of a run, extracted as `reconstruct mesh` does, or of a file in which a unit of length is `unit`.

    Raises:
        UsageError: there is nothing that can be read, or a run's scene has no metres.
        DatasetError: the mesh is damaged or has no triangles.
    """
    path = Path(path)
    if path.is_dir():
        return _of_run(path, stands_on)
    mesh = reading.read(path)
    if not len(mesh.faces) or not mesh.area > 0:
        remedy = "give a mesh with triangles, not points alone"
        raise DatasetError("mesh is empty", where=path, why=f"{len(mesh.faces)} triangles", remedy=remedy)
    mesh.apply_scale(METRES[unit])
    stated = _stated(mesh, path)
    if stated is not None:
        return Stated(path.name, mesh, *stated)
    mesh.merge_vertices(merge_norm=True, merge_tex=True)  # STL has three of its own for each triangle
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.remove_unreferenced_vertices()
    return Stated(path.name, mesh)


def attach(mesh: "trimesh.Trimesh", found: "Uncertain") -> None:
    """State the errors of a mesh's vertices as properties, which PLY files keep and `read` finds."""
    properties = {DEVIATION: found.deviation, COMMON: found.common, OUTLINE: found.outline}
    mesh.vertex_attributes.update({name: values.astype(np.float32) for name, values in properties.items()})
    mesh.vertex_attributes[KNOWN] = found.known.astype(np.uint8)


def finer(surface: Stated) -> Stated:
    """The same surface with vertices close enough to measure at; unchanged where its errors are stated."""
    import trimesh

    longest = FINEST * surface.size
    if surface.deviation is not None or float(surface.mesh.edges_unique_length.max()) <= longest:
        return surface
    vertices, faces = trimesh.remesh.subdivide_to_size(surface.mesh.vertices, surface.mesh.faces, longest, max_iter=30)
    fine = trimesh.Trimesh(vertices, faces, process=False)
    fine.merge_vertices()
    return Stated(surface.name, fine)


def _of_run(path: Path, stands_on: str | None) -> Stated:
    from koala3d.reconstruct.backend import configure_process
    from koala3d.reconstruct.output.mesh import extraction
    from koala3d.reconstruct.output.shape import uncertainty
    from koala3d.reconstruct.output.trained_model import TrainedModel

    if not (path / RUN).is_file():
        raise UsageError("is neither a mesh nor a run", where=path, remedy=f"give a run, or one of {', '.join(reading.READABLE)}")
    configure_process()
    trained = TrainedModel.open(path)
    if not trained.scene.metric:
        why, remedy = "its scene has no unit of length", "scale the scene first: datasets edit --help"
        raise UsageError("shapes are compared in metres", where=path, why=why, remedy=remedy)
    mesh = extraction.extract(trained, stands_on=stands_on)
    found = uncertainty.of(trained, mesh)
    return Stated(path.name, mesh, found.deviation, found.common, found.known, found.outline)


def _stated(
    mesh: "trimesh.Trimesh", path: Path
) -> tuple[Float[np.ndarray, " v"], Float[np.ndarray, " v"], Bool[np.ndarray, " v"], Float[np.ndarray, " v"]] | None:
    """What a PLY file of `reconstruct mesh` states of its vertices; None where it states nothing."""
    vertices = mesh.metadata.get("_ply_raw", {}).get("vertex", {}).get("data")
    names = vertices.dtype.names if isinstance(vertices, np.ndarray) and vertices.dtype.names else ()
    if DEVIATION not in names or len(vertices) != len(mesh.vertices):
        return None
    count = len(mesh.vertices)
    local, common, outline = (
        np.asarray(vertices[name], np.float64).reshape(count) if name in names else np.zeros(count)
        for name in (DEVIATION, COMMON, OUTLINE)
    )
    known = np.asarray(vertices[KNOWN]).reshape(count) != 0 if KNOWN in names else np.ones(count, bool)
    if not (np.isfinite([local, common, outline]).all() and min(local.min(), common.min(), outline.min()) >= 0):
        raise DatasetError("states impossible deviations", where=path, why="negative, or not finite", remedy="extract it again")
    return local, common, known, outline
