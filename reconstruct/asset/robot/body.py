"""A body for simulators: a textured mesh, its convex parts and its inertia in one frame.

The frame: metres, z up, its origin on the table below the centre of gravity; the axes of a scene that stands on -z are kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from koala3d.datasets import pose
from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.asset import asset as assets
from koala3d.reconstruct.asset.asset import FACES, SIZE, Asset
from koala3d.reconstruct.asset.robot.convex import PARTS, convex_parts
from koala3d.reconstruct.asset.robot.mass import Inertia, Weight, inertia
from koala3d.reconstruct.output.mesh import extraction
from koala3d.reconstruct.output.trained_model import TrainedModel

if TYPE_CHECKING:
    import trimesh

STANDING = 0.01  # what is lower than this share of the height stands on the table
ASSET_FROM_BODY = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Turns z up into the y up of assets."""


@dataclass(frozen=True)
class Body:
    """Everything that a simulator's files are written from."""

    asset: Asset
    """Its mesh is in the body's frame, z up; `base_from_asset` leads from there to the world of the scene."""
    parts: "tuple[trimesh.Trimesh, ...]"
    """Convex, in the body's frame. Their lowest corners are level, see `level`."""
    inertia: Inertia
    """In the body's frame."""
    margin: float
    """How far the centre of gravity is inside the area that the body stands on [m]; negative: it falls over."""


def make(
    trained: TrainedModel,
    weight: Weight,
    *,
    faces: int = FACES,
    size: int = SIZE,
    resolution: int = extraction.RESOLUTION,
    stands_on: str | None = None,
    parts: int = PARTS,
) -> Body:
    """Extract, bake, decompose and weigh a trained model; arguments as for `asset.make`, `parts` as for `convex_parts`.

    Raises UsageError: the scene is not in metres.
    """
    if not trained.scene.metric:
        remedy = "give the scene a unit: datasets edit SCENE --help; then train again"
        raise UsageError("the scene is not in metres", where=trained.scene.name, why="mass and inertia need them", remedy=remedy)
    import coacd  # noqa: F401  is missed before minutes of work, not after

    surface = extraction.extract(trained, resolution=resolution, watertight=True, faces=faces, stands_on=stands_on)
    asset, _ = assets.bake(trained, surface, size=size, stands_on=stands_on)
    return body(asset, surface, weight, parts=parts)


def body(asset: Asset, surface: "trimesh.Trimesh", weight: Weight, *, parts: int = PARTS) -> Body:
    """The body of an asset, whose frame has y up, and of the surface that it was made of, in the world of the scene."""
    turned = asset.base_from_asset @ ASSET_FROM_BODY
    local = surface.copy()
    local.apply_transform(pose.inverse(turned))
    found = convex_parts(local, parts)
    moments = inertia(local, found, weight)
    origin = np.array([*moments.centre[:2], min(part.bounds[0, 2] for part in found)])
    found = level([part.apply_translation(-origin) for part in found])
    base_from_body = turned @ pose.rigid(np.eye(3), origin)
    mesh = asset.mesh.moved(pose.inverse(base_from_body) @ asset.base_from_asset)
    corners = np.concatenate([part.vertices for part in found])
    return Body(
        replace(asset, mesh=mesh, base_from_asset=base_from_body), found, moments.moved(-origin), standing_margin(corners)
    )


def level(parts: "Sequence[trimesh.Trimesh]") -> "tuple[trimesh.Trimesh, ...]":
    """The parts with what is lower than `STANDING` of the height put on the table, z = 0.

    No camera sees the underside, so a model's is uneven by chance, and a body with bumps below rocks. The object stood still
    when it was photographed.
    """
    import trimesh

    height = max(part.bounds[1, 2] for part in parts)
    flat = []
    for part in parts:
        corners = part.vertices.copy()
        corners[corners[:, 2] < STANDING * height, 2] = 0
        flat.append(trimesh.Trimesh(corners, part.faces).convex_hull)
    return tuple(flat)


def standing_margin(corners: Float[np.ndarray, "n 3"]) -> float:
    """Distance of the z axis from the edge of the area that points at z = 0 span [m]; negative outside of it."""
    from scipy.spatial import ConvexHull, QhullError

    low = corners[corners[:, 2] < 1e-9, :2]
    try:
        return float(-ConvexHull(low).equations[:, 2].max())
    except QhullError:  # an edge or a point
        return -float(np.linalg.norm(low, axis=-1).min())
