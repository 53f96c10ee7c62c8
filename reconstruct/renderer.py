"""Whole pictures from a trained model: rays in chunks, each as long as its occupied space allows."""

from dataclasses import dataclass, field

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.typing import NDArray

from datasets.camera_model import Camera
from datasets.scene import View
from reconstruct.model import Footprint, cloud_of, render
from reconstruct.rays import Rays, view_rays
from reconstruct.rendering import composite
from reconstruct.safe import normalise
from reconstruct.sampling.packing import expected_depth
from reconstruct.sampling.samples import RaySamples
from reconstruct.step import StepFunctions, TrainState

CHUNK, CAPACITY = 4096, 65536
"""Rays per chunk, and samples."""
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
    middle = jnp.full(rays.origins.shape[0], 0.5)
    depth = expected_depth(state.occupancy, rays, functions.steps(rays), middle, functions.normalisation.bounded)
    samples, fits = functions.sampled(jax.lax.optimization_barrier(depth), rays, middle, middle, CAPACITY)
    return jax.lax.optimization_barrier(samples), Footprint(), fits


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
            normals: also composite density normals, which costs about as much again.
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
        crowded = not self.functions.normalisation.bounded  # every ray meets the surroundings
        chunk = min(CHUNK // 2 if crowded else CHUNK, max(256, 1 << (len(origins) - 1).bit_length()))
        function = self._function(chunk, normals, furthest is not None)
        limit = jnp.asarray(np.inf if furthest is None else furthest, jnp.float32)
        parts, start = [], 0
        while start < len(origins):
            rows = np.minimum(np.arange(start, start + chunk), len(origins) - 1)
            rays = Rays(jnp.asarray(origins[rows]), jnp.asarray(directions[rows]), jnp.asarray(radii[rows]))
            values, done = function(state, rays, limit)
            count = min(int(done), len(origins) - start)
            parts.append(np.asarray(values[:count]))
            start += count
        values = np.concatenate(parts)
        ends = np.cumsum(list(CHANNELS.values()))
        return dict(zip(CHANNELS, np.split(values, ends[:-1], -1), strict=True))

    def _function(self, chunk: int, normals: bool, limited: bool):
        key = (chunk, normals, limited)
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
            _, _, per_sample = model.field.with_normals(cloud)
            normals = composite(per_sample, samples.packed(rendered.weights), samples)
        columns = {
            "rgb": jnp.clip(rendered.over(jnp.asarray(self.behind)[None]), 0, 1), "opacity": rendered.opacity[:, None],
            "diffuse": rendered.diffuse, "specular": rendered.specular, "roughness": rendered.roughness[:, None],
            "depth": jnp.where(rendered.opacity > 0.01, rendered.depth, 0.0)[:, None],
            "normals_pred": rendered.normals_pred, "normals": normals,
        }  # fmt: skip
        return jnp.concatenate([columns[name] for name in CHANNELS], -1), jnp.sum(fits)
