"""Whole pictures from a trained model: rays in chunks, each as long as its occupied space allows."""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import NDArray

from datasets.camera_model import Camera
from datasets.scene import View
from reconstruct.field.appearance import Material
from reconstruct.field.cloud import Cloud
from reconstruct.field.field import Field
from reconstruct.numerics.compiling import jit
from reconstruct.numerics.safe import normalise
from reconstruct.rendering.model import Model, Rendered, render
from reconstruct.sampling.samples import RaySamples, cloud_of
from reconstruct.scene.light import STILL, LightFrame
from reconstruct.scene.rays import Normalisation, Rays, view_rays

SIZES = (256, 1024, 4096, 16384)
"""Rays that are rendered at once, the fewest that hold a whole picture; the last only off the processor: see `sizes`."""
Lists = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32] | None]
"""Origins, directions and radii of many rays, and their lamps' rotations (None where lamps stand still), on the host."""
BLOCKS = (8192, 131072)
"""Samples that are evaluated at once, on a processor and elsewhere."""
AT_ONCE = 3
"""Programs that are under way at the same time: one alone leaves a core idle in its serial parts, and while it is read back."""
FAINT = 1e-3
"""Share of a ray's opacity below which a sample's normal is left out: two dozen of them turn the sum by 1.4 degrees at most."""
CHANNELS = {"rgb": 3, "opacity": 1, "diffuse": 3, "specular": 3, "roughness": 1, "depth": 1, "normals_pred": 3, "normals": 3}


@dataclass(frozen=True)
class Picture:
    """What the model sees through a camera; every array is (height, width, channels), float32."""

    rgb: NDArray[np.float32]
    """sRGB in 0..1 over the background."""
    opacity: NDArray[np.float32]
    diffuse: NDArray[np.float32]
    """Linear, premultiplied with opacity."""
    specular: NDArray[np.float32]
    """Linear, tint included, premultiplied with opacity."""
    roughness: NDArray[np.float32]
    depth: NDArray[np.float32]
    """Along z, in the scene's world unit; zero where nothing is seen."""
    normals: NDArray[np.float32]
    """Unit, world frame, from the density's gradient; zero where nothing is seen."""
    normals_pred: NDArray[np.float32]
    """The same from the predicted normals."""


def block() -> int:
    """That of `BLOCKS` for this platform."""
    return BLOCKS[jax.default_backend() != "cpu"]


def composited_normals(field: Field, cloud: Cloud, samples: RaySamples, rendered: Rendered) -> Float[Array, "rays 3"]:
    """Sum of each ray's weighted density normals, of those samples that add to it; as many blocks of them as there are.

    A gradient costs three times what the density costs, and most samples lie before the surface or behind it.
    """
    weights = samples.packed(rendered.weights)
    adds = weights > FAINT * rendered.opacity[samples.ray]
    (chosen,) = jnp.nonzero(adds, size=weights.shape[0], fill_value=0)
    count = jnp.sum(adds)
    size = min(block(), weights.shape[0])

    def add(index: Array, total: Float[Array, "rays 3"]) -> Float[Array, "rays 3"]:
        entry = index * size + jnp.arange(size)
        sample = chosen[jnp.minimum(entry, weights.shape[0] - 1)]
        _, _, normals = field.with_normals(cloud.of(sample))
        return total.at[samples.ray[sample]].add((normals * jnp.where(entry < count, weights[sample], 0.0)).T)

    return jax.lax.fori_loop(0, (count + size - 1) // size, add, jnp.zeros((samples.num_rays, 3)))


def by_blocks(field: Field, cloud: Cloud, samples: RaySamples) -> tuple[Float[Array, " n"], Material]:
    """What `field` returns, evaluated for as many blocks as samples fill; zero for the rest of the list, which nobody sees."""
    size, count = min(block(), samples.t.shape[0]), jnp.sum(samples.valid)
    if samples.t.shape[0] % size:
        return field(cloud)

    def evaluated(index: Array) -> tuple[Array, Material]:
        return field(cloud.of(index * size + jnp.arange(size)))

    def add(index: Array, whole: tuple[Array, Material]) -> tuple[Array, Material]:
        put = lambda whole, part: jax.lax.dynamic_update_slice_in_dim(whole, part, index * size, axis=-1)  # noqa: E731
        return jax.tree.map(put, whole, evaluated(index))

    shapes = jax.eval_shape(evaluated, jnp.zeros((), jnp.int32))
    empty = jax.tree.map(lambda leaf: jnp.zeros((*leaf.shape[:-1], samples.t.shape[0]), leaf.dtype), shapes)
    return jax.lax.fori_loop(0, (count + size - 1) // size, add, empty)


def sizes() -> tuple[int, ...]:
    """Those of `SIZES` for this platform: a GPU is idle while results are read back, so that it gets larger parts."""
    return SIZES[:-1] if jax.default_backend() == "cpu" else SIZES


def _size(picture: int) -> int:
    """Rays at once for a picture of so many: one size for each picture, so that nothing is compiled in its midst."""
    return next((size for size in sizes() if size >= picture), sizes()[-1])


def _slice(start: int, end: int, picture: int) -> Int[np.ndarray, " size"]:
    """The indices from `start` on that are rendered at once, the last before `end` repeated."""
    return np.minimum(np.arange(start, start + _size(picture)), end - 1)


def _filled(rows: Int[np.ndarray, " n"], size: int) -> Int[np.ndarray, " size"]:
    """As many indices as are rendered at once, the last one repeated."""
    return rows[np.minimum(np.arange(size), len(rows) - 1)]


def taken(rays: Lists, rows: Int[np.ndarray, " size"]) -> Lists:
    """Some of the rays, by their indices."""
    origins, directions, radii, light = rays
    return origins[rows], directions[rows], radii[rows], None if light is None else light[rows]


def on_device(rays: Lists) -> Rays:
    """The same rays as programs take them."""
    origins, directions, radii, light = rays
    lit = None if light is None else jnp.asarray(light)
    return Rays(jnp.asarray(origins), jnp.asarray(directions), jnp.asarray(radii), light=lit)


@dataclass
class Renderer:
    """Renders views with a model of one scene. Compiles once per instance."""

    normalisation: Normalisation
    background: tuple[float, float, float] = (1.0, 1.0, 1.0)
    light: LightFrame = STILL
    """Where the scene's lamps stand still."""
    _compiled: dict[Any, Any] = field(default_factory=dict)

    @property
    def behind(self) -> tuple[float, float, float]:
        """What is seen where a ray meets nothing: the background, or black where surroundings are part of the scene."""
        return self.background if self.normalisation.bounded or self.normalisation.backdrop else (0.0, 0.0, 0.0)

    def rays_of(self, view: View, camera: Camera) -> Lists:
        """All rays of a view, row by row, as `rays` takes them."""
        lists = view_rays(view, self.normalisation, camera)
        light = self.light.of_views((view,))
        return *lists, None if light is None else np.broadcast_to(light, (len(lists[0]), 3, 3))

    def picture(self, model: Model, view: View, camera: Camera | None = None, *, normals: bool = True) -> Picture:
        """Render a view, through its own camera or another one at the same place.

        Args:
            normals: also composite density normals, which costs about half as much again.
        """
        camera = camera or view.camera
        flat = self.rays(model, *self.rays_of(view, camera), normals=normals)
        images = {name: value.reshape(camera.height, camera.width, -1) for name, value in flat.items()}
        for name in ("normals", "normals_pred"):
            images[name] = np.asarray(normalise(jnp.asarray(images[name])))
        images["depth"] = images["depth"] / self.normalisation.scale
        return Picture(**images)

    def rays(
        self,
        model: Model,
        origins: NDArray[Any],
        directions: NDArray[Any],
        radii: NDArray[Any],
        light: NDArray[Any] | None = None,
        *,
        normals: bool = False,
        furthest: float | None = None,
    ) -> dict[str, NDArray[np.float32]]:
        """Render n rays: a dictionary of (n, channels) arrays as in `CHANNELS`, depth in scene units.

        Args:
            light: (n, 3, 3) rotations to the lamps' axes, see `LightFrame`; None where lamps stand still.
            furthest: what is beyond this depth is left out [scene unit]; infinity leaves out nothing. None: the same, in a
                program without this limit.
        """
        given = (origins, directions, radii, light)
        values = np.zeros((len(origins), sum(CHANNELS.values())), np.float32)
        values[:, :3] = np.clip(self.behind, 0, 1)
        left, size = np.flatnonzero(self._meets(model, given)), _size(len(origins))
        function = self._function(normals, furthest is not None)
        limit = jnp.asarray(np.inf if furthest is None else furthest, jnp.float32)
        running: deque[Any] = deque()
        while len(left) or running:
            while len(left) and len(running) < AT_ONCE:
                rows, left = left[:size], left[size:]
                running.append((rows, function(model, on_device(taken(given, _filled(rows, size))), limit)))
            rows, (found, done) = running.popleft()
            count = min(int(done), len(rows))
            values[rows[:count]] = np.asarray(found)[:count]
            left = np.concatenate([rows[count:], left])  # those that found no room
        ends = np.cumsum(list(CHANNELS.values()))
        return dict(zip(CHANNELS, np.split(values, ends[:-1], -1), strict=True))

    def warm_up(self, model: Model, given: Lists) -> None:
        """Compile what `rays` needs for as many rays, normals included, by rendering a few of them."""
        rows = _slice(0, len(given[0]), len(given[0]))
        few = taken(given, rows)
        self._meets(model, few)
        jax.block_until_ready(self._function(True, False)(model, on_device(few), jnp.asarray(np.inf, jnp.float32)))

    def _meets(self, model: Model, rays: Lists) -> Bool[np.ndarray, " n"]:
        """Which rays are worth rendering: in pictures of an object alone, most meet nothing."""
        count = len(rays[0])
        if not model.sampler.skips_rays:
            return np.ones(count, bool)
        if "meets" not in self._compiled:
            self._compiled["meets"] = jit(lambda model, rays: model.sampler.meets(rays))
        look = self._compiled["meets"]
        parts = [look(model, on_device(taken(rays, _slice(start, count, count)))) for start in range(0, count, _size(count))]
        return np.concatenate(parts)[:count]

    def _function(self, normals: bool, limited: bool):
        key = (normals, limited)
        if key not in self._compiled:
            self._compiled[key] = jit(
                lambda model, rays, furthest: self._render(model, rays, normals, furthest if limited else None)
            )
        return self._compiled[key]

    def _render(
        self, model: Model, rays: Rays, with_normals: bool, furthest: Float[Array, ""] | None
    ) -> tuple[Float[Array, "rays channels"], Array]:
        """All channels side by side, and how many rays from the first on found room."""
        found = model.sampler.look(rays)
        samples = found.samples
        if furthest is not None:  # an interval of no length absorbs nothing
            samples = eqx.tree_at(lambda s: s.length, samples, jnp.where(samples.t > furthest, 0.0, samples.length))
        cloud = cloud_of(rays, samples, space=self.normalisation.space, footprint=found.footprint)
        rendered, _ = render(model.field, rays, samples, cloud, by_blocks(model.field, cloud, samples))
        normals = jnp.zeros_like(rendered.normals_pred)
        if with_normals:
            normals = composited_normals(model.field, cloud, samples, rendered)
        columns = {
            "rgb": jnp.clip(rendered.over(jnp.asarray(self.behind)[None]), 0, 1),
            "opacity": rendered.opacity[:, None],
            "diffuse": rendered.diffuse,
            "specular": rendered.specular,
            "roughness": rendered.roughness[:, None],
            "depth": jnp.where(rendered.opacity > 0.01, rendered.depth, 0.0)[:, None],
            "normals_pred": rendered.normals_pred,
            "normals": normals,
        }
        return jnp.concatenate([columns[name] for name in CHANNELS], -1), jnp.sum(found.fits)
