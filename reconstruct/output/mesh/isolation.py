"""Isolates the object in a grid of densities from surroundings that enter its box.

`solid` cells are denser than the surface or enclosed by such cells; `depth` is the distance of a solid cell from the nearest
other cell, in cells; a side of the box is "-x", "+x" and so on.
"""

import numpy as np
from jaxtyping import Bool, Float

SIDES = tuple(f"{sign}{axis}" for axis in "xyz" for sign in "-+")  # sides of a box, in the order of its axes
CORE = (0.5, 0.25, 0.125)  # minimum depth of the object's core, as shares of the largest depth, tried in this order
TABLE_TOP = 1 / 128  # largest height of a reconstructed table top above its side of the box, in the longest side of the grid


def fill_interior(density: Float[np.ndarray, "x y z"], threshold: float) -> Float[np.ndarray, "x y z"]:
    """The density with the interior of the surface filled.

    Models may leave the inside of a solid empty, since no camera sees it. Where a side of the box cuts the object, the area
    inside its outline belongs to the interior.
    """
    from scipy.ndimage import binary_fill_holes

    solid = density > threshold
    for side in SIDES:
        face = _face(side)
        solid[face] = binary_fill_holes(solid[face])
    inside = np.asarray(binary_fill_holes(solid), bool) & (density <= threshold)
    return np.where(inside, max(float(density.max()), threshold), density)


def isolate_object(density: Float[np.ndarray, "x y z"], threshold: float, stands_on: str) -> Float[np.ndarray, "x y z"]:
    """The density without the table top, and without anything that enters the box through another side than the table's.

    After a short training, thin bridges connect sheets of table or wall with the object. The solid is divided between the
    object's core and those sides where it is thinnest (watershed of the depth, Meyer 1994). If no solid reaches these sides, or
    no core is separate from them, only the table top is removed: an object that the box cuts stays whole.

    Args:
        threshold: density of the surface [1 / scene unit].
        stands_on: the side of `SIDES` that the object stands on.
    """
    from scipy.ndimage import distance_transform_edt
    from skimage.segmentation import watershed

    solid = fill_interior(density, threshold) > threshold
    cleared = _without_table_top(density, solid, stands_on)
    if cleared is not density:
        density, solid = cleared, fill_interior(cleared, threshold) > threshold
    outside = np.zeros_like(solid)
    for side in SIDES:
        if side != stands_on:
            outside[_face(side)] = solid[_face(side)]
    if not outside.any():
        return density
    depth = np.asarray(distance_transform_edt(solid), np.float32)
    core = _core(depth, outside)
    if core is None:
        return density
    parts = watershed(-depth, outside + 2 * core.astype(np.int8), mask=solid)
    return np.where(parts == 1, density.dtype.type(0), density)


def _without_table_top(
    density: Float[np.ndarray, "x y z"], solid: Bool[np.ndarray, "x y z"], stands_on: str
) -> Float[np.ndarray, "x y z"]:
    """The density without columns of solid cells that rise no higher than `TABLE_TOP` above the side that the object stands on.

    If the box ends at the table, noise decides whether a layer of its top, one or two cells thick, lies inside. Higher columns
    belong to the object. If there are none, the density is returned unchanged.
    """
    layers, axis, upwards = round(TABLE_TOP * max(density.shape)), "xyz".index(stands_on[1]), 1 if stands_on[0] == "-" else -1
    from_table = np.moveaxis(solid, axis, 0)[::upwards]
    top = from_table[:layers] & ~from_table[layers]
    if not top.any() or not from_table[layers].any():
        return density
    cleared = density.copy()
    np.moveaxis(cleared, axis, 0)[::upwards][:layers][top] = 0
    return cleared


def _core(depth: Float[np.ndarray, "x y z"], outside: Bool[np.ndarray, "x y z"]) -> Bool[np.ndarray, "x y z"] | None:
    """The largest deep piece that is separate from `outside`; None without any."""
    from scipy.ndimage import label

    for share in CORE:
        pieces = np.zeros(depth.shape, np.int32)
        label(depth > share * depth.max(), output=pieces)
        sizes = np.bincount(pieces.reshape(-1))
        sizes[np.unique(pieces[outside])] = 0
        sizes[0] = 0
        if sizes.any():
            return pieces == int(np.argmax(sizes))
    return None


def _face(side: str) -> tuple[slice | int, ...]:
    """Index of the cells at a side."""
    return tuple((0 if side[0] == "-" else -1) if axis == side[1] else slice(None) for axis in "xyz")
