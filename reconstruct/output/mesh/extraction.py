"""The surface of a trained model as a triangle mesh, in the scene's world coordinates.

The density is sampled on a regular grid over the object's box, in and around occupied cells, and cut by marching cubes
where a ray has lost `level` of its light (`volume.optical_depth`), or, in a fog, where a stretch as long as 1/128 of
the box absorbs as much. That length belongs to the model and not to the mesh, so that a finer mesh shows the same surface in more
detail. Where the model predicts normals, the mesh is refined to follow them.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from koala3d.datasets.scene import Scene
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.numerics.volume import SURFACE
from koala3d.reconstruct.output.mesh.closing import is_closed, mended
from koala3d.reconstruct.output.mesh.field_samples import frontal_colours, grid_axes, predicted_normals, sample_density
from koala3d.reconstruct.output.mesh.isolation import SIDES, fill_interior, isolate_object
from koala3d.reconstruct.output.mesh.refinement import follow_normals
from koala3d.reconstruct.output.mesh.solid import AROUND, SHELLS, Solid
from koala3d.reconstruct.output.trained_model import TrainedModel

if TYPE_CHECKING:
    import trimesh

RESOLUTION = 256  # grid points along the longest side of the box
LEVEL = 0.5  # share of light that is lost at the surface
FOLLOWED = 1 / 24  # share of the box's longest side over which predicted normals are believed more than the density
SMALLEST_PART = 0.05  # pieces with less than this share of the largest piece's area are noise


def extract(
    trained: TrainedModel,
    *,
    resolution: int = RESOLUTION,
    level: float = LEVEL,
    watertight: bool = False,
    faces: int | None = None,
    stands_on: str | None = None,
    follow: bool = True,
) -> "trimesh.Trimesh":
    """Mesh of the object: world coordinates, outward vertex normals, colours as viewed along the normals.

    Args:
        resolution: grid points along the longest side of the object's box.
        level: see `LEVEL`; above 0 and below 1.
        watertight: close the surface where it leaves the box, for printing and for volumes.
        faces: target number of triangles (quadric error, Garland and Heckbert 1997); None keeps all. A closed surface stays
            closed, see `closing`.
        stands_on: side of the box, such as "-z", that the object stands on: remove the table top there and whatever enters the
            box through other sides, see `isolation`; None keeps all.
        follow: refine the surface to follow the predicted normals, see `refinement`, of a model that has them.

    Raises ReconstructError: there is no surface in the box.
    """
    import trimesh

    axes = grid_axes(trained, resolution)
    density = sample_density(trained, axes)
    side = max(axis[-1] - axis[0] for axis in axes)
    length = SURFACE if trained.model.field.solid else side / 128
    threshold = -np.log1p(-level) / length
    if not density.min() < threshold < density.max():
        why = f"densities are {density.min():.3g} to {density.max():.3g}, the surface is at {threshold:.3g}"
        problem, advice = "there is no surface in the object's box", "train longer, or check the scene's box"
        raise ReconstructError(problem, where=trained.run.path, why=why, remedy=advice)
    spacing = axes[0][1] - axes[0][0]
    first = np.array([axis[0] for axis in axes])
    if stands_on is not None:
        density = isolate_object(density, threshold, stands_on)
    if watertight:
        density, first = np.pad(fill_interior(density, threshold), 1), first - spacing
    mesh = _cut(density, threshold, spacing, first)
    if follow and trained.model.field.appearance.predicts_normals:
        normals = predicted_normals(trained, mesh.vertices)
        vertices = follow_normals(mesh.vertices, mesh.faces, normals, over=FOLLOWED * side)
        mesh = trimesh.Trimesh(vertices, mesh.faces, process=False)
    if faces is not None and faces < len(mesh.faces):
        mesh = mesh.simplify_quadric_decimation(face_count=faces)
    mesh = mended(mesh)
    shells = (
        _shells(trained, density, [-np.log1p(-share) / length for share in AROUND], spacing, first) if is_closed(mesh) else None
    )
    colours = frontal_colours(trained, mesh.vertices, mesh.vertex_normals)
    world = mesh.vertices / trained.run.normalisation.scale + trained.run.normalisation.centre
    about: dict[str, Any] = {} if shells is None else {SHELLS: shells}
    kept: dict[str, Any] = {"vertex_normals": mesh.vertex_normals, "vertex_colors": colours, "metadata": about}
    return trimesh.Trimesh(world, mesh.faces, process=False, **kept)


def _cut(
    density: Float[np.ndarray, "x y z"], threshold: float, spacing: float, first: Float[np.ndarray, " 3"]
) -> "trimesh.Trimesh":
    """The surface where the density is `threshold`, from marching cubes, without noise.

    Density grows exponentially into the surface: interpolating its logarithm does not pull the surface to the empty side.
    """
    import trimesh
    from skimage.measure import marching_cubes

    # 'ascent' makes faces point outward, since skimage counts axes backwards.
    logarithm, crossing = np.log(density + 1e-3 * threshold), float(np.log(1.001 * threshold))
    vertices, triangles, _, _ = marching_cubes(logarithm, crossing, spacing=(spacing,) * 3, gradient_direction="ascent")
    return main_parts(trimesh.Trimesh(vertices + first, triangles, process=False))


def _shells(
    trained: TrainedModel,
    density: Float[np.ndarray, "x y z"],
    thresholds: list[float],
    spacing: float,
    first: Float[np.ndarray, " 3"],
) -> list[tuple[float, Float[np.ndarray, " 3"]]] | None:
    """Volume and centre, in the world, of the surfaces at these densities; None where one of them is missing or open."""
    known, found = trained.run.normalisation, []
    for threshold in thresholds:
        shell = _cut(density, threshold, spacing, first) if threshold < density.max() else None
        if shell is None or not is_closed(shell):
            return None
        found.append((shell.volume / known.scale**3, shell.center_mass / known.scale + known.centre))
    return found


def summary(surface: "trimesh.Trimesh", scene: Scene) -> tuple[dict[str, Any], str]:
    """Size, number of triangles, open sides, and of a closed surface what it encloses; for a program and for a person."""
    size, open_at = surface.extents.tolist(), sides_reached(surface, scene.box)
    counts = {"vertices": len(surface.vertices), "faces": len(surface.faces)}
    found = {**counts, "size": size, "metric": scene.metric, "open_at": open_at}
    solid = Solid.of(surface, scene)
    found |= {} if solid is None else solid.to_json()
    text = f"{len(surface.faces)} triangles, {' x '.join(f'{side:.3f}' for side in size)} {'m' if scene.metric else 'units'}"
    if solid is not None:
        text = f"{text}\n{solid.words(scene)}"
    if len(open_at) == 1:
        text = f"open at {open_at[0]}, where it leaves the object's box; --watertight closes it\n{text}"
    elif open_at:
        sides, example = ", ".join(open_at), "-z" if "-z" in open_at else open_at[0]
        advice = f"surroundings may be part of it; --stands-on {example} removes what enters through other sides"
        text = f"open at {sides}, where it leaves the object's box: {advice}\n{text}"
    return found, text


def sides_reached(surface: "trimesh.Trimesh", box: Float[np.ndarray, "2 3"]) -> list[str]:
    """Sides of the object's box, such as "-z", at which the surface ends: the box cuts the object, or surroundings are included.

    A side counts if open edges of the surface lie beyond it, or within a thousandth of the box's longest side.
    """
    from trimesh.grouping import group_rows

    edges = surface.edges[group_rows(surface.edges_sorted, require_count=1)]
    ends = surface.vertices[np.unique(edges)] if len(edges) else np.zeros((0, 3))
    low, high = box
    at = np.stack([ends - low, high - ends]).min(1, initial=np.inf) < 1e-3 * (high - low).max()
    return [side for side, reached in zip(SIDES, at.T.reshape(-1), strict=True) if reached]


def main_parts(mesh: "trimesh.Trimesh") -> "trimesh.Trimesh":
    """The mesh without noise, pieces of less than `SMALLEST_PART` of the largest piece's area, and without cavities.

    A cavity is a closed piece that faces inward: the model left the inside of a solid empty, where no camera sees it.
    """
    from trimesh.graph import connected_component_labels

    labels = connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    areas = np.bincount(labels, weights=mesh.area_faces)
    is_closed = np.ones(len(areas), bool)
    is_closed[labels[np.bincount(mesh.face_adjacency.reshape(-1), minlength=len(mesh.faces)) < 3]] = False
    volumes = np.bincount(labels, weights=np.linalg.det(mesh.triangles) / 6)  # of the tetrahedra from the origin to each face
    wanted = (areas >= SMALLEST_PART * areas.max()) & ~(is_closed & (volumes < 0))
    kept = mesh.copy()
    kept.update_faces(wanted[labels])
    kept.remove_unreferenced_vertices()
    return kept
