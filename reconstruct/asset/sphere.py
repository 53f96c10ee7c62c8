"""Light from all directions, as values at the nodes of a sphere; and what rough surfaces mirror of it.

    lobe of roughness r    the share of light from each node that a surface of GGX's alpha = r^2 mirrors
                           towards its normal's direction

That is the light of the split sum (Karis 2013, "Real Shading in Unreal Engine 4"): normal, view and reflected direction are one.
"""

from functools import cache

import numpy as np
from jaxtyping import Float, Int

SUBDIVISIONS = 4  # of an icosahedron: 2562 nodes, 4 degrees apart
ROUGHNESS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.75, 1.0)
"""Roughness of the lobes. Sharper ones than the first cannot be told apart at the nodes' distance."""
NEAREST = 3  # nodes between which a direction lies
AROUND = 40  # nodes of which a perfect mirror shows something
NODE_WIDTH = np.deg2rad(2.5)
"""Standard deviation of the smallest lobe: what is mirrored by a perfect mirror is known as finely as the nodes are."""
SMALLEST = NODE_WIDTH / 2
"""Its alpha: a normal's angle is half the reflection's."""


@cache
def nodes() -> Float[np.ndarray, "nodes 3"]:
    """Unit vectors, evenly spread."""
    from trimesh.creation import icosphere

    return np.asarray(icosphere(subdivisions=SUBDIVISIONS).vertices)


@cache
def lobes() -> Float[np.ndarray, "levels nodes nodes"]:
    """For each of `ROUGHNESS` the shares of the nodes' light (columns) in the light mirrored into each direction (rows)."""
    cosine = np.clip(nodes() @ nodes().T, -1, 1).astype(np.float32)
    angle = np.arccos(cosine)
    found = np.empty((len(ROUGHNESS), *cosine.shape), np.float32)
    for lobe, roughness in zip(found, ROUGHNESS, strict=True):
        lobe[:] = np.maximum(cosine, 0) * _ggx(angle, np.hypot(roughness**2, SMALLEST))
        lobe /= lobe.sum(-1, keepdims=True)
    return found


def _ggx(angle: Float[np.ndarray, "..."], alpha: float) -> Float[np.ndarray, "..."]:
    """Lobe of GGX, up to a factor, at an angle from the mirrored direction, which is twice the normal's."""
    return 1 / (np.cos(angle / 2) ** 2 * (alpha**2 - 1) + 1) ** 2


@cache
def _tree():
    from scipy.spatial import KDTree

    return KDTree(nodes())


def nearest_nodes(directions: Float[np.ndarray, "n 3"]) -> tuple[Int[np.ndarray, "n near"], Float[np.ndarray, "n near"]]:
    """The nodes around directions, and the share of each."""
    distance, index = _tree().query(directions, k=NEAREST)
    shares = 1 / np.maximum(distance, 1e-4)
    return index, shares / shares.sum(-1, keepdims=True)


def at(values: Float[np.ndarray, "nodes channels"], directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n channels"]:
    """Values of nodes in any directions."""
    index, shares = nearest_nodes(directions)
    return np.sum(values[index] * shares[..., None], axis=1)


def mirrored_at(
    values: Float[np.ndarray, "nodes channels"], directions: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n channels"]:
    """What a perfect mirror shows of the nodes' values in any directions: `lobes` of roughness 0, smooth between the nodes."""
    distance, index = _tree().query(directions, k=AROUND)
    shares = _ggx(2 * np.arcsin(np.minimum(distance / 2, 1)), SMALLEST)
    return np.sum(values[index] * (shares / shares.sum(-1, keepdims=True))[..., None], axis=1)
