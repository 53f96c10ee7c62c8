"""Traces rays against shiny solids under distant light, by sphere tracing (Hart 1996).

A hit shows its matte part and reflects the light or, where the reflected ray hits a solid again, that solid's matte part and its
reflection of the light. Matte parts receive the light without shadows.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from koala3d.reconstruct.numerics.safe import safe_norm
from koala3d.reconstruct.rendered.lamps import Lamps, arriving
from koala3d.reconstruct.rendered.light import MATTE
from koala3d.reconstruct.rendered.solids import Distance, normals

ON_SURFACE = 1e-5  # a ray has hit below this distance [radius of the scene]
STEPS, ROUNDS = 16, 16  # steps between selections of the rays that continue, and the maximum number of these
CHUNK = 8192  # rays traced at once: one size, so that each program is compiled once
Vectors = Float[Array, "3 n"]


@dataclass(frozen=True)
class Material:
    """Reflection by a solid's surface; linear."""

    matte: tuple[float, float, float]  # share of light that is scattered evenly
    mirror: tuple[float, float, float]
    """Share that is reflected at normal incidence; all at grazing angles (Schlick 1994)."""
    sharpness: float  # concentration of the lobe around the reflected direction
    second: tuple[float, float, float] | None = None
    """Matte colour of every second patch; None without a pattern."""
    patches: float = 8.0  # patches per unit, times pi

    def matte_at(self, points: Vectors) -> Vectors:
        """Matte share at points."""
        first = jnp.broadcast_to(np.array(self.matte, np.float32)[:, None], points.shape)
        if self.second is None:
            return first
        share = jax.nn.sigmoid(12 * jnp.prod(jnp.sin(self.patches * points + 0.4), 0))
        return first + share * (np.array(self.second, np.float32)[:, None] - first)


@dataclass(frozen=True)
class Body:
    """One solid of one material."""

    solid: Distance
    material: Material


@dataclass(frozen=True, eq=False)
class Tracer:
    """Traces rays through a scene inside the unit ball. Compiles on first use: keep one per scene."""

    bodies: tuple[Body, ...]
    light: Lamps

    def distance(self, points: Vectors) -> Float[Array, " n"]:
        """Signed distance of (3, n) points from the nearest body."""
        return jnp.min(self._distances(points), 0)

    def measured(self, points: NDArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Signed distance (n,) and unit outward normal (n, 3) of (n, 3) points, a chunk at a time."""
        distance, normal = self._in_chunks(_measured, points)
        return distance, normal

    def nearest(self, points: NDArray) -> NDArray[np.int64]:
        """(n,) index of the body that is nearest to each of (n, 3) points."""
        return self._in_chunks(_nearest, points)[0].astype(np.int64)

    def _distances(self, points: Vectors) -> Float[Array, "bodies n"]:
        return jnp.stack([body.solid(points) for body in self.bodies])

    def look(
        self, origins: NDArray, directions: NDArray, lamps_from_scene: NDArray | None = None
    ) -> dict[str, NDArray[np.float32]]:
        """Radiance, distance and normals along (n, 3) rays with unit directions.

        Args:
            lamps_from_scene: (4, 4) where the lamps stand, in the tracer's unit; None: where the scene does.

        Returns:
            "t" (n,) distance of the hit, 0 for none; "normals" (n, 3); "diffuse" and "specular" (n, 3) linear light.
        """
        t = self.cast(origins, directions)
        hit = np.flatnonzero(t > 0)
        points = origins[hit] + t[hit, None] * directions[hit]
        found = {"t": t, **{name: np.zeros((len(t), 3), np.float32) for name in ("normals", "diffuse", "specular")}}
        if not len(hit):
            return found
        normal, mirrored = self._in_chunks(_turned, points, directions[hit])
        again = self.cast(points + 1e-3 * normal, mirrored)
        stand = () if lamps_from_scene is None else (np.broadcast_to(lamps_from_scene[:3].ravel(), (len(hit), 12)),)
        seen = self._in_chunks(_shaded, points, directions[hit], points + 1e-3 * normal, mirrored, again, *stand)
        for name, values in zip(("normals", "diffuse", "specular"), (normal, *seen), strict=True):
            found[name][hit] = values
        return found

    def cast(self, origins: NDArray, directions: NDArray) -> NDArray[np.float32]:
        """(n,) distance at which (n, 3) rays with unit directions hit a solid; 0 for none."""
        enter, leave = _ball_interval(origins, directions)
        t, arrived = enter.copy(), np.zeros(len(enter), bool)
        going = np.flatnonzero(leave > enter)
        for _ in range(ROUNDS):
            if not len(going):
                break
            t[going], gap = self._in_chunks(_marched, origins[going], directions[going], t[going])
            arrived[going] = gap < ON_SURFACE
            going = going[(gap >= ON_SURFACE) & (t[going] < leave[going])]
        arrived[going] = True  # rays that still approach a surface touch it
        return np.where(arrived & (t < leave), t, 0).astype(np.float32)

    def _in_chunks(self, function, *rows: NDArray) -> tuple[NDArray[np.float32], ...]:
        """Apply a compiled function of columns to any number of rows."""
        parts = []
        for start in range(0, len(rows[0]), CHUNK):
            part = [values[start : start + CHUNK].astype(np.float32) for values in rows]
            full = [np.resize(values, (CHUNK, *values.shape[1:])).T for values in part]
            parts.append([np.asarray(values).T[: len(part[0])] for values in function(self, *full)])
        return tuple(np.concatenate(values) for values in zip(*parts, strict=True))

    def _material(self, points: Vectors) -> tuple[Vectors, Vectors, Float[Array, " n"]]:
        """Matte share, reflected share at normal incidence, and sharpness of the nearest body."""
        nearest = jnp.argmin(self._distances(points), 0)
        matte, mirror, sharpness = jnp.zeros_like(points), jnp.zeros_like(points), jnp.ones_like(points[0])
        for index, body in enumerate(self.bodies):
            own = nearest == index
            matte = jnp.where(own, body.material.matte_at(points), matte)
            mirror = jnp.where(own, np.array(body.material.mirror, np.float32)[:, None], mirror)
            sharpness = jnp.where(own, body.material.sharpness, sharpness)
        return matte, mirror, sharpness


@partial(jax.jit, static_argnums=0)
def _marched(tracer: Tracer, origins: Vectors, directions: Vectors, t: Float[Array, " n"]):
    """t after several steps, and the distance from the surface there."""

    def step(_, t):
        gap = tracer.distance(origins + t * directions)
        return t + jnp.where(gap < ON_SURFACE, 0.0, gap)

    t = jax.lax.fori_loop(0, STEPS, step, t)
    return t, tracer.distance(origins + t * directions)


@partial(jax.jit, static_argnums=0)
def _measured(tracer: Tracer, points: Vectors):
    """Distance and normals of points."""
    return tracer.distance(points), normals(tracer.distance, points)


@partial(jax.jit, static_argnums=0)
def _nearest(tracer: Tracer, points: Vectors):
    """Index of the nearest body."""
    return (jnp.argmin(tracer._distances(points), 0),)


@partial(jax.jit, static_argnums=0)
def _turned(tracer: Tracer, points: Vectors, directions: Vectors):
    """Normals, and directions reflected about them."""
    normal = normals(tracer.distance, points)
    mirrored = directions - 2 * jnp.sum(directions * normal, 0) * normal
    return normal, mirrored / safe_norm(mirrored, axis=0)


@partial(jax.jit, static_argnums=0)
def _shaded(
    tracer: Tracer,
    points: Vectors,
    directions: Vectors,
    leaving: Vectors,
    mirrored: Vectors,
    again: Float[Array, " n"],
    stand: Float[Array, "12 n"] | None = None,
):
    """Matte and reflected light of hits whose reflected rays hit a solid at the distance `again`, 0 for none.

    Args:
        stand: rows of `lamps_from_scene` at each hit; None: lamps stand still in the scene.
    """
    light = partial(arriving, tracer.light, stand)
    matte, mirror, sharpness = tracer._material(points)
    normal = normals(tracer.distance, points)
    other = leaving + again * mirrored
    other_matte, other_mirror, other_sharpness = tracer._material(other)
    other_normal = normals(tracer.distance, other)
    twice = mirrored - 2 * jnp.sum(mirrored * other_normal, 0) * other_normal
    from_body = other_matte * light(other, other_normal, MATTE)
    from_body += _schlick(other_mirror, mirrored, other_normal) * light(other, twice, other_sharpness)
    reflected = jnp.where(again > 0, from_body, light(points, mirrored, sharpness))
    return matte * light(points, normal, MATTE), _schlick(mirror, directions, normal) * reflected


def _schlick(head_on: Vectors, directions: Vectors, normal: Vectors) -> Vectors:
    """Reflected share at the angle between a ray and a normal (Schlick 1994)."""
    grazing = jnp.clip(1 + jnp.sum(directions * normal, 0), 0, 1) ** 5
    return head_on + (1 - head_on) * grazing


def _ball_interval(origins: NDArray, directions: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where rays with unit directions enter and leave the unit ball; an empty interval if they miss it."""
    origins, directions = origins.astype(np.float64), directions.astype(np.float64)
    closest = -(origins * directions).sum(-1)
    half = 1 - ((origins + closest[:, None] * directions) ** 2).sum(-1)
    half = np.where(half > 0, np.sqrt(np.maximum(half, 0)), -1.0)
    return np.maximum(closest - half, 0), np.where(half > 0, closest + half, -1.0)
