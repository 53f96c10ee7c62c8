"""The surface of a trained model as a triangle mesh, in the scene's world coordinates.

The density is sampled on a regular grid over the object's box, where the occupancy grid holds anything at all, and
cut by marching cubes where a stretch as long as 1/128 of the box absorbs `level` of the light. That length belongs to the
model and not to the mesh, so that a finer mesh shows the same surface in more detail. Where the model predicts normals, the
surface's slopes are made to follow them.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from datasets.core.console import progress
from datasets.core.files import atomic_path
from datasets.scene import Scene
from reconstruct.errors import ReconstructError
from reconstruct.field.cloud import Cloud
from reconstruct.field.field import Field
from reconstruct.numerics.safe import normalise
from reconstruct.output.restored import Trained
from reconstruct.output.slopes import follow_normals
from reconstruct.output.stray_matter import SIDES, filled, left_out
from reconstruct.sampling.occupancy import Occupancy

if TYPE_CHECKING:
    import trimesh

RESOLUTION = 256
"""Grid points along the longest side of the box."""
LEVEL = 0.5
"""Share of light that a stretch of surface material as long as 1/128 of the box absorbs."""
CHUNK = 1 << 17
"""Points evaluated at once."""
FOLLOWED = 1 / 24
"""Share of the box's longest side over which predicted normals are believed more than the density."""
SMALLEST_PART = 0.05
"""Pieces with less than this share of the largest piece's area are noise."""


def extract(
    trained: Trained,
    *,
    resolution: int = RESOLUTION,
    level: float = LEVEL,
    watertight: bool = False,
    faces: int | None = None,
    stands_on: str | None = None,
    follow: bool = True,
) -> "trimesh.Trimesh":
    """Mesh of the object: world coordinates, outward vertex normals, colours as seen straight on.

    Args:
        resolution: grid points along the longest side of the object's box.
        level: see `LEVEL`; above 0 and below 1.
        watertight: close the surface where it leaves the box, for printing and for volumes.
        faces: simplify to about so many triangles (quadric error, Garland and Heckbert 1997); None keeps all.
        stands_on: leave out the table's top at this side, such as "-z", and what reaches into the box through any other; None keeps
            all, see `surroundings`.
        follow: let the surface follow the predicted normals, see `slopes`, of a model that has them.

    Raises:
        ReconstructError: there is no surface in the box.
    """
    import trimesh
    from skimage.measure import marching_cubes

    axes = grid_axes(trained, resolution)
    density = sample_density(trained, axes)
    side = max(axis[-1] - axis[0] for axis in axes)
    threshold = -np.log1p(-level) * 128 / side
    if not density.min() < threshold < density.max():
        raise ReconstructError("there is no surface in the object's box", where=trained.run.path,
                               why=f"densities are {density.min():.3g} to {density.max():.3g}, the surface is at {threshold:.3g}",
                               remedy="train longer, or check the scene's box")  # fmt: skip
    spacing = axes[0][1] - axes[0][0]
    first = np.array([axis[0] for axis in axes])
    if stands_on is not None:
        density = left_out(density, threshold, stands_on)
    if watertight:
        density, first = np.pad(filled(density, threshold), 1), first - spacing
    # Density grows exponentially into the surface: interpolating its logarithm does not pull the surface to the empty side.
    # 'ascent' makes faces point outward, since skimage counts axes backwards.
    vertices, triangles, _, _ = marching_cubes(np.log(density + 1e-3 * threshold), float(np.log(1.001 * threshold)),
                                           spacing=(spacing,) * 3, gradient_direction="ascent")  # fmt: skip
    mesh = main_parts(trimesh.Trimesh(vertices + first, triangles, process=False))
    if follow and trained.state.model.field.appearance.predicts_normals:
        normals = predicted_normals(trained, mesh.vertices)
        vertices = follow_normals(mesh.vertices, mesh.faces, normals, over=FOLLOWED * side)
        mesh = trimesh.Trimesh(vertices, mesh.faces, process=False)
    if faces is not None and faces < len(mesh.faces):
        mesh = mesh.simplify_quadric_decimation(face_count=faces)
    colours = colours_straight_on(trained, mesh.vertices, mesh.vertex_normals)
    world = mesh.vertices / trained.run.normalisation.scale + trained.run.normalisation.centre
    return trimesh.Trimesh(world, mesh.faces, vertex_normals=mesh.vertex_normals, vertex_colors=colours, process=False)


def summary(surface: "trimesh.Trimesh", scene: Scene) -> tuple[dict[str, Any], str]:
    """What a surface consists of, where it ends and in which unit, for a program and for a person."""
    size, open_at = surface.extents.tolist(), sides_reached(surface, scene.box)
    found = {
        "vertices": len(surface.vertices),
        "faces": len(surface.faces),
        "size": size,
        "metric": scene.metric,
        "open_at": open_at,
    }
    text = f"{len(surface.faces)} triangles, {' x '.join(f'{side:.3f}' for side in size)} {'m' if scene.metric else 'units'}"
    if len(open_at) == 1:
        text = f"open at {open_at[0]}, where it leaves the object's box; --watertight closes it\n{text}"
    elif open_at:
        sides, example = ", ".join(open_at), "-z" if "-z" in open_at else open_at[0]
        text = (f"open at {sides}, where it leaves the object's box: surroundings may be part of it; "
                f"--stands-on {example} leaves out what reaches in through other sides\n{text}")  # fmt: skip
    return found, text


def sides_reached(surface: "trimesh.Trimesh", box: Float[np.ndarray, "2 3"]) -> list[str]:
    """Sides of the object's box at which the surface ends, such as "-z": cut by them, or surroundings that were taken along.

    A side counts where open edges of the surface lie at it, to a thousandth of the box's longest side, or beyond, as the grid does.
    """
    from trimesh.grouping import group_rows

    edges = surface.edges[group_rows(surface.edges_sorted, require_count=1)]
    ends = surface.vertices[np.unique(edges)] if len(edges) else np.zeros((0, 3))
    low, high = box
    at = np.stack([ends - low, high - ends]).min(1, initial=np.inf) < 1e-3 * (high - low).max()
    return [side for side, reached in zip(SIDES, at.T.reshape(-1), strict=True) if reached]


def grid_axes(trained: Trained, resolution: int) -> tuple[NDArray[np.float64], ...]:
    """Coordinates of the grid points along x, y and z [scene unit]: equal spacing, the box covered."""
    normalisation = trained.run.normalisation
    low, high = (np.asarray(trained.scene.box) - normalisation.centre) * normalisation.scale
    spacing = (high - low).max() / (resolution - 1)
    return tuple(a + spacing * np.arange(int(np.ceil((b - a) / spacing - 1e-6)) + 1) for a, b in zip(low, high, strict=True))


def sample_density(trained: Trained, axes: tuple[NDArray[np.float64], ...]) -> Float[np.ndarray, "x y z"]:
    """Density [1 / scene unit] at the grid points; zero where the occupancy grid is empty around."""
    wanted = np.ones(tuple(len(axis) for axis in axes), bool)
    if trained.state.occupancy is not None:
        wanted = near_occupied(trained.state.occupancy, axes)
    density = np.zeros(wanted.shape, np.float32)
    index = np.flatnonzero(wanted)
    with progress("sampling density", len(index) / 1e6, "million points") as shown:
        for part, points in _chunks(index, axes):
            values = _density(trained.state.model.field, points, trained.run.normalisation.bounded)
            density.reshape(-1)[part] = np.asarray(values)[: len(part)]
            shown.advance(len(part) / 1e6)
    return density


def near_occupied(occupancy: Occupancy, axes: tuple[NDArray[np.float64], ...]) -> NDArray[np.bool_]:
    """(x, y, z) True for grid points in an occupied cell of the inner grid or next to one."""
    from scipy.ndimage import binary_dilation

    size = occupancy.grid
    cells = np.asarray(occupancy.occupied[: size**3]).reshape(size, size, size)
    cells = np.asarray(binary_dilation(cells, np.ones((3, 3, 3))), bool)
    return cells[np.ix_(*(np.clip(((axis + 1) * size / 2).astype(int), 0, size - 1) for axis in axes))]


def main_parts(mesh: "trimesh.Trimesh") -> "trimesh.Trimesh":
    """The mesh without noise, pieces of less than `SMALLEST_PART` of the largest piece's area, and without cavities.

    A cavity is a closed piece that faces inward. No camera has seen it: it is where a model left out the inside of a solid.
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


def colours_straight_on(trained: Trained, points: NDArray, normals: NDArray) -> NDArray[np.uint8]:
    """(n, 3) sRGB of points [scene unit] seen against their normal: diffuse and specular, as metals have no diffuse part."""
    field, bounded = trained.state.model.field, trained.run.normalisation.bounded
    values = _by_chunks(lambda part, facing: _colour(field, part, facing, bounded), points, normals)
    return np.round(255 * np.clip(values, 0, 1)).astype(np.uint8)


def predicted_normals(trained: Trained, points: NDArray) -> NDArray[np.float32]:
    """(n, 3) unit normals that the model predicts at points [scene unit]."""
    field, bounded = trained.state.model.field, trained.run.normalisation.bounded
    return _by_chunks(lambda part: _normals(field, part, bounded), points)


def points_on(mesh: "trimesh.Trimesh", count: int, seed: int = 0) -> "trimesh.PointCloud":
    """`count` points spread evenly over a mesh, with its colours, and its normals as `metadata["normals"]`."""
    import trimesh
    from trimesh.sample import sample_surface

    places, triangles = sample_surface(mesh, count, seed=seed)[:2]
    visual: Any = mesh.visual
    shares = trimesh.triangles.points_to_barycentric(mesh.triangles[triangles], places)[..., None]
    corners = mesh.faces[triangles]
    colours = np.sum(visual.vertex_colors[corners][..., :3] * shares, axis=1)
    normals = np.sum(mesh.vertex_normals[corners] * shares, axis=1)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    rounded = np.clip(np.round(colours), 0, 255).astype(np.uint8)
    return trimesh.PointCloud(np.asarray(places), colors=rounded, metadata={"normals": normals})


SUFFIXES = (".ply", ".glb", ".obj")
"""Forms of mesh files."""


def save(mesh: "trimesh.Trimesh", path: Path) -> None:
    """Write a mesh atomically with normals and colours, in the form that the suffix names."""
    with atomic_path(path) as temporary:
        options = {"include_normals": True} if path.suffix.lower() in (".glb", ".obj") else {"vertex_normal": True}
        mesh.export(temporary, file_type=path.suffix.lower()[1:], **options)


def save_points(cloud: "trimesh.PointCloud", path: Path) -> None:
    """Write points with normals and colours atomically as binary PLY."""
    kinds = [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")] + [(name, "u1") for name in ("red", "green", "blue")]
    rows = np.zeros(len(cloud.vertices), kinds)
    columns = [*cloud.vertices.T, *cloud.metadata["normals"].T, *np.asarray(cloud.colors)[:, :3].T]
    for (name, _), values in zip(kinds, columns, strict=True):
        rows[name] = values
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    header += [f"property {'float' if kind == '<f4' else 'uchar'} {name}" for name, kind in kinds]
    with atomic_path(path) as temporary:
        temporary.write_bytes("\n".join([*header, "end_header\n"]).encode() + rows.tobytes())


def _chunks(
    index: NDArray[np.int64], axes: tuple[NDArray[np.float64], ...]
) -> Iterator[tuple[NDArray[np.int64], Float[Array, "3 n"]]]:
    shape = tuple(len(axis) for axis in axes)
    for start in range(0, len(index), CHUNK):
        part = index[start : start + CHUNK]
        places = np.unravel_index(part, shape)
        yield part, _padded(np.stack([axis[place] for axis, place in zip(axes, places, strict=True)], -1))


def _by_chunks(function: Callable[..., Float[Array, "3 n"]], *arrays: NDArray) -> NDArray[np.float32]:
    """(n, 3) values of a function of (3, CHUNK) arrays at the rows of (n, 3) arrays."""
    values = np.zeros((len(arrays[0]), 3), np.float32)
    for start in range(0, len(values), CHUNK):
        part = slice(start, min(start + CHUNK, len(values)))
        values[part] = np.asarray(function(*(_padded(array[part]) for array in arrays)))[:, : part.stop - start].T
    return values


def _padded(points: NDArray) -> Float[Array, "3 n"]:
    """(3, CHUNK): one compiled program for all chunks."""
    padded = np.zeros((3, CHUNK), np.float32)
    padded[:, : len(points)] = points.T
    return jnp.asarray(padded)


@eqx.filter_jit
def _density(field: Field, points: Float[Array, "3 n"], bounded: bool) -> Float[Array, " n"]:
    return field.density(Cloud(points, None, bounded))


@eqx.filter_jit
def _colour(field: Field, points: Float[Array, "3 n"], normals: Float[Array, "3 n"], bounded: bool) -> Float[Array, "3 n"]:
    _, material = field(Cloud(points, None, bounded))
    return field.shade(material, -normals).rgb


@eqx.filter_jit
def _normals(field: Field, points: Float[Array, "3 n"], bounded: bool) -> Float[Array, "3 n"]:
    _, material = field(Cloud(points, None, bounded))
    return normalise(material.normals_pred, axis=0)
