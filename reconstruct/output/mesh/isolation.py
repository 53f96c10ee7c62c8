"""What in a grid of densities is the object, and what reaches into its box from outside.

Words: `solid` are the cells denser than the surface and what they shut in; `depth` is how far a cell is from the nearest that is
not solid, in cells; a side of the box is "-x", "+x" and so on.
"""

import numpy as np
from jaxtyping import Bool, Float

SIDES = tuple(f"{sign}{axis}" for axis in "xyz" for sign in "-+")
"""Sides of a box, in the order of its axes."""
CORE = (0.5, 0.25, 0.125)
"""The object's core is at least so deep, in the depth of the deepest cell; the first that gives one counts."""
TABLE_TOP = 1 / 128
"""How far above its side of the box a table's reconstructed top may be, in the longest side of the grid."""


def fill_interior(density: Float[np.ndarray, "x y z"], threshold: float) -> Float[np.ndarray, "x y z"]:
    """The density with solid matter wherever the surface and the sides of the box shut it in.

    Nobody sees the inside of a solid, so that a model may leave it empty; where the object is cut by a side of the box, what its
    outline there encloses is its inside.
    """
    from scipy.ndimage import binary_fill_holes

    solid = density > threshold
    for side in SIDES:
        face = _face(side)
        solid[face] = binary_fill_holes(solid[face])
    inside = np.asarray(binary_fill_holes(solid), bool) & (density <= threshold)
    return np.where(inside, max(float(density.max()), threshold), density)


def isolate_object(density: Float[np.ndarray, "x y z"], threshold: float, stands_on: str) -> Float[np.ndarray, "x y z"]:
    """The density without the table's top, and without what reaches into the box through another side than the table's.

    A short training leaves a sheet of table or wall that hangs on to the object by a thin bridge. Solid matter is divided
    between the object's core and those other sides where it is thinnest in between (watershed of the depth, Meyer 1994). Nothing
    else is left out where the sides are not reached, or where there is no core apart from them: an object that the box cuts
    through stays whole.

    Args:
        threshold: density of the surface [1 / scene unit].
        stands_on: the side that the object stands on, of `SIDES`.
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
    """The density without solid cells beside the object that rise no higher than `TABLE_TOP` over the side that it stands on.

    Where the box begins at the table, noise decides whether a sheet of its top, a cell or two thick, lies inside. What rises
    higher, and all below it, is the object's. Where nothing does, the density is returned as it is.
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
    """The largest deep piece that is apart from `outside`; None where there is none."""
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
    """Index of the outermost cells at a side."""
    return tuple((0 if side[0] == "-" else -1) if axis == side[1] else slice(None) for axis in "xyz")
