"""Solids as signed distances: negative inside, at most the true distance outside.

Unit: the radius of the ball that holds the whole scene. After Quilez, "Distance functions" (2008 and later).
"""

from collections.abc import Callable
from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from koala3d.reconstruct.numerics.safe import safe_norm

Points = Float[Array, "3 n"]
Distance = Callable[[Points], Float[Array, " n"]]
"""Signed distance of (3, n) points."""


def ball(radius: float) -> Distance:
    """A sphere about the origin."""
    return lambda p: safe_norm(p, axis=0) - radius


def torus(major: float, minor: float) -> Distance:
    """A ring about the z axis: `major` to the middle of the tube, `minor` the tube's radius."""
    return lambda p: jnp.hypot(safe_norm(p[:2], axis=0) - major, p[2]) - minor


def block(half: tuple[float, float, float], edge: float) -> Distance:
    """A cuboid of these half sides, its edges rounded to the radius `edge`."""
    core = np.array(half, np.float32)[:, None] - edge

    def distance(p: Points) -> Float[Array, " n"]:
        beyond = jnp.abs(p) - core
        return safe_norm(jnp.maximum(beyond, 0), axis=0) + jnp.minimum(jnp.max(beyond, 0), 0) - edge

    return distance


def puck(radius: float, half_height: float, edge: float) -> Distance:
    """A cylinder about the z axis, its rims rounded to the radius `edge`."""

    def distance(p: Points) -> Float[Array, " n"]:
        beyond = jnp.stack([safe_norm(p[:2], axis=0) - radius, jnp.abs(p[2]) - half_height]) + edge
        return safe_norm(jnp.maximum(beyond, 0), axis=0) + jnp.minimum(jnp.max(beyond, 0), 0) - edge

    return distance


def rod(start: tuple[float, float, float], end: tuple[float, float, float], radius: float) -> Distance:
    """A stick with round ends."""
    first = np.array(start, np.float32)[:, None]
    along = np.array(end, np.float32)[:, None] - first

    def distance(p: Points) -> Float[Array, " n"]:
        share = jnp.clip(jnp.sum((p - first) * along, 0) / float((along**2).sum()), 0, 1)
        return safe_norm(p - first - share * along, axis=0) - radius

    return distance


def placed(solid: Distance, at: tuple[float, float, float], turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Distance:
    """A solid turned about x, then y, then z [deg], and moved to `at`."""
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix().astype(np.float32)
    place = np.array(at, np.float32)[:, None]
    return lambda p: solid(jnp.matmul(rotation.T, p - place, precision="highest"))


def blended(reach: float, *solids: Distance) -> Distance:
    """Solids blended where they are closer than about `reach` (Quilez' polynomial smooth minimum)."""

    def both(first: Distance, second: Distance) -> Distance:
        def distance(p: Points) -> Float[Array, " n"]:
            a, b = first(p), second(p)
            near = jnp.maximum(reach - jnp.abs(a - b), 0) / reach
            return jnp.minimum(a, b) - near * near * reach / 4

        return distance

    return reduce(both, solids)


def normals(solid: Distance, points: Points) -> Points:
    """Unit outward normals at points of the surface: the exact gradient of the distance."""
    gradient = jax.grad(lambda p: jnp.sum(solid(p)))(points)
    return gradient / jnp.maximum(safe_norm(gradient, axis=0), 1e-6)
