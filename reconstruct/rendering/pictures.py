"""Whole pictures from a trained model: rays in chunks, each as long as its occupied space allows."""

from dataclasses import dataclass, field

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import NDArray

from datasets.camera_model import Camera
from datasets.scene import View
from reconstruct.field.cloud import Cloud
from reconstruct.field.field import Field
from reconstruct.numerics.safe import normalise
from reconstruct.rendering.model import Footprint, Rendered, cloud_of, render
from reconstruct.sampling.packing import expected_depth
from reconstruct.sampling.samples import RaySamples
from reconstruct.scene.rays import Rays, view_rays
from reconstruct.training.step import StepFunctions, TrainState

SIZES, PER_RAY = (256, 1024, 4096), 16
"""Rays that are rendered at once, the fewest that hold a whole picture; and room for samples. Surroundings need twice as much."""
Lists = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]
"""Origins, directions and radii of many rays, on the host."""
BLOCK = 8192
"""Samples whose normals are found at once."""
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


def sampled_rays(functions: StepFunctions, state: TrainState, rays: Rays) -> tuple[RaySamples, Footprint, Bool[Array, " rays"]]:
    """Where rays are looked at, what stands for their frustums, and which of them found room; nothing is left to chance."""
    if state.occupancy is None:
        samples, _, _, footprint = functions.propose(state.model, rays, None)
        return jax.lax.optimization_barrier(samples), footprint, jnp.ones(rays.origins.shape[0], bool)
    count, longest = rays.origins.shape[0], functions.config.sampler.max_per_ray
    middle = jnp.full(count, 0.5)
    depth = jax.lax.optimization_barrier(_occupied(functions, state, rays))
    room = max(longest, min(longest, PER_RAY if functions.normalisation.bounded else 2 * PER_RAY) * count)
    samples, fits = functions.sampled(depth, rays, middle, middle, room)
    return jax.lax.optimization_barrier(samples), Footprint(), fits


def _occupied(functions: StepFunctions, state: TrainState, rays: Rays) -> Float[Array, "rays steps"]:
    """Optical depth that the grid expects in the steps of rays, each looked at in its middle."""
    middle = jnp.full(rays.origins.shape[0], 0.5)
    return expected_depth(state.occupancy, rays, functions.steps(rays), middle, functions.normalisation.bounded)


def composited_normals(field: Field, cloud: Cloud, samples: RaySamples, rendered: Rendered) -> Float[Array, "rays 3"]:
    """Sum of each ray's weighted density normals, of those samples that add to it; as many blocks of them as there are.

    A gradient costs three times what the density costs, and most samples lie before the surface or behind it.
    """
    weights = samples.packed(rendered.weights)
    adds = weights > FAINT * rendered.opacity[samples.ray]
    (chosen,) = jnp.nonzero(adds, size=weights.shape[0], fill_value=0)
    count = jnp.sum(adds)
    size = min(BLOCK, weights.shape[0])

    def add(block: Array, total: Float[Array, "rays 3"]) -> Float[Array, "rays 3"]:
        entry = block * size + jnp.arange(size)
        sample = chosen[jnp.minimum(entry, weights.shape[0] - 1)]
        _, _, normals = field.with_normals(cloud.of(sample))
        return total.at[samples.ray[sample]].add((normals * jnp.where(entry < count, weights[sample], 0.0)).T)

    return jax.lax.fori_loop(0, (count + size - 1) // size, add, jnp.zeros((samples.num_rays, 3)))


def _size(picture: int) -> int:
    """Rays at once for a picture of so many: one size for each picture, so that nothing is compiled in its midst."""
    return next((size for size in SIZES if size >= picture), SIZES[-1])


def _slice(start: int, end: int, picture: int) -> Int[np.ndarray, " size"]:
    """The indices from `start` on that are rendered at once, the last before `end` repeated."""
    return np.minimum(np.arange(start, start + _size(picture)), end - 1)


def _chosen(rays: Lists, rows: Int[np.ndarray, " size"]) -> Rays:
    return Rays(*(jnp.asarray(values[rows]) for values in rays))


@dataclass
class Renderer:
    """Renders views of a training state. Compiles once per instance."""

    functions: StepFunctions
    background: tuple[float, float, float] = (1.0, 1.0, 1.0)
    _compiled: dict = field(default_factory=dict)

    @property
    def behind(self) -> tuple[float, float, float]:
        """What is seen where a ray meets nothing: the background, or black where surroundings are part of the scene."""
        normalisation = self.functions.normalisation
        return self.background if normalisation.bounded or normalisation.backdrop else (0.0, 0.0, 0.0)

    def picture(self, state: TrainState, view: View, camera: Camera | None = None, *, normals: bool = True) -> Picture:
        """Render a view, through its own camera or another one at the same place.

        Args:
            normals: also composite density normals, which costs about half as much again.
        """
        camera = camera or view.camera
        origins, directions, radii = view_rays(view, self.functions.normalisation, camera)
        flat = self.rays(state, origins, directions, radii, normals=normals)
        images = {name: value.reshape(camera.height, camera.width, -1) for name, value in flat.items()}
        unit = lambda v: np.asarray(normalise(jnp.asarray(v)))  # noqa: E731
        images["normals"], images["normals_pred"] = unit(images["normals"]), unit(images["normals_pred"])
        images["depth"] = images["depth"] / self.functions.normalisation.scale
        return Picture(**images)

    def rays(self, state: TrainState, origins, directions, radii, *, normals: bool = False,
             furthest: float | None = None) -> dict[str, NDArray[np.float32]]:  # fmt: skip
        """Render n rays: a dictionary of (n, channels) arrays as in `CHANNELS`, depth in scene units.

        Args:
            furthest: what is beyond this depth is left out [scene unit]; infinity leaves out nothing, None does not ask.
        """
        given = (origins, directions, radii)
        values = np.zeros((len(origins), sum(CHANNELS.values())), np.float32)
        values[:, :3] = np.clip(self.behind, 0, 1)
        wanted = np.flatnonzero(self._meets(state, given))
        function = self._function(normals, furthest is not None)
        limit = jnp.asarray(np.inf if furthest is None else furthest, jnp.float32)
        start = 0
        while start < len(wanted):
            rows = wanted[_slice(start, len(wanted), len(origins))]
            found, done = function(state, _chosen(given, rows), limit)
            count = min(int(done), len(wanted) - start)
            values[rows[:count]] = found[:count]
            start += count
        ends = np.cumsum(list(CHANNELS.values()))
        return dict(zip(CHANNELS, np.split(values, ends[:-1], -1), strict=True))

    def warm_up(self, state: TrainState, origins, directions, radii) -> None:
        """Compile what `rays` needs for so many rays, normals included, by rendering a few of them."""
        given = (origins, directions, radii)
        few = _chosen(given, _slice(0, len(origins), len(origins)))
        self._meets(state, (few.origins, few.directions, few.radii))
        jax.block_until_ready(self._function(True, False)(state, few, jnp.asarray(np.inf, jnp.float32)))

    def _meets(self, state: TrainState, rays: Lists) -> Bool[np.ndarray, " n"]:
        """Which rays meet occupied space: where pictures are of an object alone, most do not, and cost a look at the grid."""
        count = len(rays[0])
        if state.occupancy is None or not self.functions.normalisation.bounded:
            return np.ones(count, bool)
        look = self._compiled.setdefault("meets", jax.jit(self._meet))
        parts = [look(state, _chosen(rays, _slice(start, count, count))) for start in range(0, count, _size(count))]
        return np.concatenate(parts)[:count]

    def _meet(self, state: TrainState, rays: Rays) -> Bool[Array, " rays"]:
        return jnp.any(_occupied(self.functions, state, rays) > 0, -1)

    def _function(self, normals: bool, limited: bool):
        key = (normals, limited)
        if key not in self._compiled:
            self._compiled[key] = jax.jit(
                lambda state, rays, furthest: self._render(state, rays, normals, furthest if limited else None)
            )
        return self._compiled[key]

    def _render(
        self, state: TrainState, rays: Rays, with_normals: bool, furthest: Float[Array, ""] | None
    ) -> tuple[Float[Array, "rays channels"], Array]:
        """All channels side by side, and how many rays from the first on found room."""
        functions, model = self.functions, state.model
        samples, footprint, fits = sampled_rays(functions, state, rays)
        if furthest is not None:  # an interval of no length absorbs nothing
            samples = eqx.tree_at(lambda s: s.length, samples, jnp.where(samples.t > furthest, 0.0, samples.length))
        cloud = cloud_of(rays, samples, bounded=functions.normalisation.bounded, footprint=footprint)
        rendered, _ = render(model.field, rays, samples, cloud, deferred=functions.config.field.shading == "deferred")
        normals = jnp.zeros_like(rendered.normals_pred)
        if with_normals:
            normals = composited_normals(model.field, cloud, samples, rendered)
        columns = {
            "rgb": jnp.clip(rendered.over(jnp.asarray(self.behind)[None]), 0, 1), "opacity": rendered.opacity[:, None],
            "diffuse": rendered.diffuse, "specular": rendered.specular, "roughness": rendered.roughness[:, None],
            "depth": jnp.where(rendered.opacity > 0.01, rendered.depth, 0.0)[:, None],
            "normals_pred": rendered.normals_pred, "normals": normals,
        }  # fmt: skip
        return jnp.concatenate([columns[name] for name in CHANNELS], -1), jnp.sum(fits)
