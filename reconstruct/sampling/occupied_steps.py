"""The sampler that goes by an occupancy grid: packed samples in occupied steps, and the grid's upkeep."""

from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray
from numpy.typing import NDArray

from koala3d.datasets.scene import View
from koala3d.datasets.structure.masks.silhouette import Slack
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.sampling import compiled, focus, plain
from koala3d.reconstruct.sampling.hull import cells_in_masks, cells_in_sight
from koala3d.reconstruct.sampling.occupancy import Occupancy
from koala3d.reconstruct.sampling.sampler import Batch, Sampled, Sampler
from koala3d.reconstruct.sampling.samples import Footprint, RaySamples, Rows, cloud_of
from koala3d.reconstruct.sampling.sight import in_sight
from koala3d.reconstruct.sampling.steps import Steps
from koala3d.reconstruct.scene.bounds import Bounds
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.frustum import Frustum
from koala3d.reconstruct.scene.rays import Normalisation, Pixels, Rays
from koala3d.reconstruct.scene.space import BOX, Space

FIRST_UPKEEP, LAST_UPKEEP, UPKEEP_CELLS = 16, 64, 65536
"""Steps between two times that the field is evaluated in so many cells of the grid, at the start and at the end."""
OUTER = 2
"""Cells per axis of the object's grid for each of the grid of the surroundings."""
RAYS_PER_SAMPLE = 5 / 32
"""Rays of a batch for each entry of the list, in front of a blank background: light reaches six or seven samples of each."""
WORTH_LOOKING = 0.5
"""Looking where light ends pays once it reaches less than this share of the samples that a ray has room for."""

Met = tuple[Int[Array, " n"], Float[Array, " n"]]
"""Cells and densities."""


class OccupiedSteps(Sampler):
    """Rays are cut into steps; those in occupied cells are drawn as they are expected to contribute, and packed into a list."""

    grid: Occupancy
    bounds: Bounds
    rays: int = eqx.field(static=True)
    capacity: int = eqx.field(static=True)
    """Entries of the list."""
    max_per_ray: int = eqx.field(static=True)
    steps: int = eqx.field(static=True)
    """Steps of a ray through the object's box."""
    space: Space = eqx.field(static=True)
    prefers_object: bool = eqx.field(static=True)
    """Whether rays that meet the object are taken sooner."""
    empty_below: float = eqx.field(static=True)
    """Optical depth of a step below which its cell is empty; 0: no cell is."""

    frustum: ClassVar[str] = "point"
    rules_out_space: ClassVar[bool] = True
    memory_grows_with_rays: ClassVar[bool] = False

    @classmethod
    def create(
        cls, key: PRNGKeyArray, config: Config, facts: SceneFacts, possible: NDArray[Any] | None, density_bias: float
    ) -> "OccupiedSteps":
        """With a full grid, less what is not `possible`."""
        sampler, space = config.sampler, facts.normalisation.space
        return cls(
            bounds=Bounds.of(facts),
            grid=Occupancy.create(
                config.train.seed,
                grid=sampler.grid,
                space=space,
                outer_grid=sampler.grid // OUTER,
                steps=sampler.steps,
                possible=possible,
            ),
            rays=sampler.rays,
            capacity=sampler.samples,
            max_per_ray=sampler.max_per_ray,
            steps=sampler.steps,
            space=space,
            prefers_object=facts.box_is_stated and facts.half_box is not None and not space.single_grid,
            empty_below=sampler.optical_depth if config.skip.empty_rays else 0.0,
        )

    @classmethod
    def possible_cells(
        cls, config: Config, pixels: Pixels, views: tuple[View, ...], normalisation: Normalisation, slack: Sequence[Slack] | None
    ) -> NDArray[np.bool_] | None:
        """Cells inside all masks where the object is all there is; elsewhere those that enough cameras see."""
        if not config.skip.empty_rays:
            return None
        if normalisation.bounded:
            return cells_in_masks(pixels, views, normalisation, config.sampler.grid, config.scale, slack=slack)
        return cells_in_sight(views, normalisation, config.sampler.grid // (1 if normalisation.frustum else OUTER))

    @property
    def rays_drawn(self) -> int:
        """As configured; where every ray meets the surroundings, no more than the list holds."""
        return self.rays if self.space.bounded else min(self.rays, self.capacity // self.max_per_ray)

    @property
    def rays_kept(self) -> int:
        """Rays of a batch once those that meet nothing are dropped."""
        return min(self.rays_drawn, int(self.capacity * RAYS_PER_SAMPLE)) if self.empty_below else self.rays_drawn

    @property
    def samples_drawn(self) -> int:
        """Entries of the list, filled or not."""
        return self.capacity

    @property
    def divided_sizes(self) -> tuple[int, ...]:
        """Rays drawn, rays kept, samples."""
        return self.rays_drawn, self.rays_kept, self.capacity

    def pixels(self, pixels: Pixels, key: PRNGKeyArray) -> Int[Array, " drawn"]:
        """Random ones; among surroundings rather those that show the object."""
        total = pixels.total
        half_box = self.bounds.half_box
        if half_box is None or not self.prefers_object:
            return jax.random.randint(key, (self.rays_drawn,), 0, total)
        index_key, jitter_key, order_key = jax.random.split(key, 3)
        index = jax.random.randint(index_key, (focus.CANDIDATES * self.rays_drawn,), 0, total)
        rays, _ = barrier(pixels.take(barrier(index)))
        weights = focus.weights(self.grid, rays, half_box, jax.random.uniform(jitter_key, index.shape))
        return index[focus.taken(order_key, weights, self.rays_drawn)]

    def ends_early(self, lit: float) -> bool:
        """Among surroundings looking takes as long as it saves; elsewhere surfaces are soft for thousands of steps."""
        return self.space.bounded and lit < WORTH_LOOKING * self.max_per_ray

    def batch(self, rays: Rays, colour: Float[Array, "rays 4"], key: PRNGKeyArray, field: Field, looks: Bool[Array, ""]) -> Batch:
        """Rays that meet something, with their samples, or with those that light reaches."""
        jitter, offset = barrier(jax.random.uniform(key, (2, self.rays_drawn)))
        most = jnp.where(looks, self.rays_drawn * self.max_per_ray, self.capacity)
        rows = self._rows(rays, jitter, offset, enough=jnp.array([self.rays_kept, most]))
        if self.rays_kept < self.rays_drawn:  # empty rays have nothing to learn from
            order, rows = rows.first_filled(self.rays_kept)
            rays, colour = jax.tree.map(lambda a: a[order], (rays, colour))
        if self.space.bounded:
            lit = lambda: in_sight(field.density, rays, rows, self.space, solid=field.solid).filled  # noqa: E731
            rows = rows._replace(filled=jax.lax.cond(looks, lit, lambda: rows.filled))
        used, samples = _way(rays).pack(rows, self.capacity)
        return Batch(rays, colour, used, samples)

    def sampled(self, batch: Batch, key: PRNGKeyArray) -> Sampled:
        """Those that the batch was made with."""
        assert batch.samples is not None  # `batch` has put them there
        return Sampled(batch.samples, Footprint(), batch.used)

    def unjittered(self, rays: Rays) -> Sampled:
        """Samples in the middle of their steps, with room for all."""
        middle = jnp.full(rays.origins.shape[0], 0.5)
        samples = RaySamples.in_rows(*self._rows(rays, middle, middle))
        return Sampled(samples, Footprint(), jnp.ones(middle.shape, bool))

    def _rows(
        self,
        rays: Rays,
        jitter: Float[Array, " rays"],
        offset: Float[Array, " rays"],
        enough: Int[Array, " 2"] | None = None,
    ) -> Rows:
        """Samples of rays, before they are packed; `enough` as of `plain.sample`."""
        steps = Steps.of(rays, steps=self.steps, space=self.space, near=self.bounds.near, far=self.bounds.far)
        options = {"max_per_ray": self.max_per_ray, "enough": enough}
        return barrier(_way(rays).sample(self.grid, rays, steps, jitter, offset, self.space, **options))

    def met(self, batch: Batch, density: Float[Array, " n"]) -> Met:
        """Cells that samples lie in, and the densities found there."""
        assert batch.samples is not None
        points, _ = cloud_of(batch.rays, batch.samples, space=self.space, footprint=Footprint()).mapped()
        return self.grid.cell(*points), jnp.where(batch.samples.valid, density, 0.0)

    def with_met(self, met: Met) -> "OccupiedSteps":
        """The grid keeps the largest densities."""
        return eqx.tree_at(lambda s: s.grid, self, self.grid.noted(*met))

    def upkeep_due(self, since: int, progress: float) -> bool:
        """Less and less often: what is empty late in a training stays empty."""
        return since >= FIRST_UPKEEP * (LAST_UPKEEP / FIRST_UPKEEP) ** progress

    def upkept(self, field: Field, key: PRNGKeyArray) -> "OccupiedSteps":
        """The field is evaluated in the next cells of the grid, and occupied cells are decided anew."""
        density_of = lambda points: field.density(Cloud(points, None, BOX))  # noqa: E731
        return eqx.tree_at(lambda s: s.grid, self, self.grid.updated(density_of, key, UPKEEP_CELLS, self.empty_below))

    def figures(self) -> dict[str, float]:
        """Share of the cells that are occupied."""
        return {"occupied": float(jnp.mean(self.grid.occupied.astype(jnp.float32)))}

    def near_occupied(self, axes: tuple[NDArray[Any], ...]) -> NDArray[np.bool_]:
        """Points in an occupied cell of the inner grid or next to one."""
        from scipy.ndimage import binary_dilation

        size = self.grid.grid
        cells = np.asarray(self.grid.occupied[: size**3]).reshape(size, size, size)
        cells = np.asarray(binary_dilation(cells, np.ones((3, 3, 3))), bool)
        if isinstance(self.space, Frustum):  # its cells are no box of the scene: each point is looked up by itself
            points = jnp.stack(jnp.meshgrid(*(jnp.asarray(axis, jnp.float32) for axis in axes), indexing="ij"))
            return cells.reshape(-1)[np.asarray(self.grid.cell(*self.space.mapped_coordinates(*points)))]
        return cells[np.ix_(*(np.clip(((axis + 1) * size / 2).astype(int), 0, size - 1) for axis in axes))]


def _way(rays: Rays) -> Any:
    """Compiled kernels if they are for these rays, else plain JAX; both have `sample` and `pack`."""
    return compiled if compiled.usable(rays) else plain
