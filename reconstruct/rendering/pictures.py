"""Whole pictures from a trained model: rays in chunks, each as long as its occupied space allows."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging.downscale import streamed
from koala3d.datasets.scene import View
from koala3d.reconstruct.numerics.compiling import jit
from koala3d.reconstruct.numerics.safe import normalise
from koala3d.reconstruct.rendering.front_to_back import Queue, sums_front_to_back
from koala3d.reconstruct.rendering.model import Model, seen
from koala3d.reconstruct.scene.light import STILL, LightFrame
from koala3d.reconstruct.scene.rays import Normalisation, Rays, view_rays

SIZES = (256, 1024, 4096, 16384, 65536)
"""Rays of one program, the fewest that hold a picture's share."""
Lists = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32] | None]
"""Origins, directions and radii of many rays, and their lamps' rotations (None where lamps stand still), on the host."""
SHARES = 4
"""Programs that a picture is rendered by, or more."""
AT_ONCE = 3
"""Programs that are under way at the same time: one alone leaves a core idle in its serial parts, and while it is read back."""
SHADED = 4096
"""Rays that are shaded at once."""
MIDDLE, DIAGONAL = (0.0, 0.0), 0.25
PLACES = (MIDDLE, (-DIAGONAL, -DIAGONAL), (DIAGONAL, DIAGONAL))
"""Where in its pixel each ray is, from the middle [px]: photographs, too, are means over pixels, and surfaces end within some."""
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


def _size(picture: int) -> int:
    """Rays of one program for a picture of so many: one size for each picture, so that nothing is compiled in its midst."""
    return next((size for size in SIZES if SHARES * size >= picture), SIZES[-1])


def _part(rays: Lists, start: int, size: int) -> tuple[Rays, Int[Array, ""]]:
    """`size` rays from `start` on, and how many of them there are: the last is repeated."""
    count = len(rays[0])
    return on_device(taken(rays, np.minimum(np.arange(start, start + size), count - 1))), jnp.asarray(min(count - start, size))


def taken(rays: Lists, rows: Int[np.ndarray, " size"]) -> Lists:
    """Some of the rays, by their indices."""
    origins, directions, radii, light = rays
    return origins[rows], directions[rows], radii[rows], None if light is None else light[rows]


def on_device(rays: Lists) -> Rays:
    """The same rays as programs take them."""
    origins, directions, radii, light = rays
    return Rays(*map(jnp.asarray, (origins, directions, radii)), light=None if light is None else jnp.asarray(light))


def ahead(begun: Iterator[Any]) -> Iterator[Any]:
    """The same, each after the next ones have been begun: they are computed while the first is read, and beside it."""
    waiting: deque[Any] = deque()
    for one in begun:
        waiting.append(one)
        if len(waiting) == AT_ONCE:
            yield waiting.popleft()
    yield from waiting


def two_at_a_time(picture: Callable[[Any], Picture], items: Sequence[Any]) -> Iterator[Picture]:
    """A picture for each item, in their order. The first is alone: it compiles what all need. Then one picture fills the core
    that the other leaves idle at its end and in what is done on the host."""
    yield from map(picture, items[:1])
    yield from streamed(picture, items[1:])


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
        """Render a view, through its own camera or another one at the same place: each pixel is the mean of its rays.

        Args:
            normals: also composite density normals, which costs about half as much again.
        """
        camera = camera or view.camera
        places = PLACES if model.sampler.frustum == "point" else (MIDDLE,)  # a cone stands for its whole pixel
        total, known = dict.fromkeys(CHANNELS, np.float32(0)), np.float32(0)
        for x, y in places:
            rays = self.rays_of(view, replace(camera, cx=camera.cx - x, cy=camera.cy - y))
            found = self.rays(model, *rays, normals=normals)
            total = {name: total[name] + values for name, values in found.items()}
            known = known + (found["depth"] > 0)
        mean = {name: values / np.float32(len(places)) for name, values in total.items()}
        mean["depth"] = total["depth"] / np.maximum(known, 1) / np.float32(self.normalisation.scale)
        for name in ("normals", "normals_pred"):
            mean[name] = np.asarray(normalise(jnp.asarray(mean[name])))
        return Picture(**{name: values.reshape(camera.height, camera.width, -1) for name, values in mean.items()})

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
        given, count = (origins, directions, radii, light), len(origins)
        values, size = np.empty((count, sum(CHANNELS.values())), np.float32), _size(count)
        function = self._function(normals, furthest is not None)
        limit = jnp.asarray(np.inf if furthest is None else furthest, jnp.float32)
        begun = ((start, function(model, *_part(given, start, size), limit)) for start in range(0, count, size))
        for start, found in ahead(begun):
            values[start : start + size] = np.asarray(found)[: count - start]
        ends = np.cumsum(list(CHANNELS.values()))
        return dict(zip(CHANNELS, np.split(values, ends[:-1], -1), strict=True))

    def warm_up(self, model: Model, given: Lists) -> None:
        """Compile what `rays` needs for as many rays, normals included, by rendering a few of them."""
        few = _part(given, 0, _size(len(given[0])))
        jax.block_until_ready(self._function(True, False)(model, *few, jnp.asarray(np.inf, jnp.float32)))

    def _function(self, normals: bool, limited: bool):
        key = (normals, limited)
        if key not in self._compiled:
            self._compiled[key] = jit(
                lambda model, rays, count, furthest: self._render(model, rays, count, normals, furthest if limited else None)
            )
        return self._compiled[key]

    def _render(
        self, model: Model, rays: Rays, count: Int[Array, ""], with_normals: bool, furthest: Float[Array, ""] | None
    ) -> Float[Array, "rays channels"]:
        """All channels of the first `count` rays side by side."""
        found, size = model.sampler.unjittered(rays), min(SHADED, rays.radii.shape[0])
        if furthest is not None:  # an interval of no length absorbs nothing
            cut = jnp.where(found.samples.t > furthest, 0.0, found.samples.length)
            found = eqx.tree_at(lambda f: f.samples.length, found, cut)
        queue = Queue.of(found.samples, count)
        sums = sums_front_to_back(model.field, rays, found, queue, self.normalisation.space, normals=with_normals)

        def shade(block: Array, values: Float[Array, "rays channels"]) -> Float[Array, "rays channels"]:
            ray = queue.ray[jnp.minimum(block * size + jnp.arange(size), queue.count - 1)]
            own = jax.tree.map(lambda v: v[ray], rays)
            return values.at[ray].set(self._columns(model, own, sums[ray], with_normals))

        behind = jnp.clip(jnp.asarray(self.behind, jnp.float32), 0, 1)
        nothing = jnp.zeros((rays.radii.shape[0], sum(CHANNELS.values()))).at[:, :3].set(behind)
        return jax.lax.fori_loop(0, (queue.count + size - 1) // size, shade, nothing)

    def _columns(
        self, model: Model, rays: Rays, sums: Float[Array, "rays _"], with_normals: bool
    ) -> Float[Array, "rays channels"]:
        """All channels of rays whose samples are composited."""
        split = sums.shape[1] - 3 if with_normals else sums.shape[1]
        shown = seen(model.field, rays, sums[:, :split].T, jnp.zeros((sums.shape[0], 0)))
        columns = {
            "rgb": jnp.clip(shown.over(jnp.asarray(self.behind)[None]), 0, 1),
            "opacity": shown.opacity[:, None],
            "diffuse": shown.diffuse,
            "specular": shown.specular,
            "roughness": shown.roughness[:, None],
            "depth": jnp.where(shown.opacity > 0.01, shown.depth, 0.0)[:, None],
            "normals_pred": shown.normals_pred,
            "normals": sums[:, split:] if with_normals else jnp.zeros_like(shown.normals_pred),
        }
        return jnp.concatenate([columns[name] for name in CHANNELS], -1)
