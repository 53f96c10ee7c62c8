"""The cost model: work of each kernel of a training step, and its time compared with the machine's limits.

A kernel is one piece of the step, compiled by itself at the step's sizes. The compiler counts operations, exponentials and
the bytes of arguments and results; lookups and additions in tables are counted here, since they cost more than their bytes.
The lower bound of the time is the largest quotient of an amount and the machine's limit for it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from koala3d.reconstruct.bench.cost.machine import Limit, fastest
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.encodings.encoding import Encoding
from koala3d.reconstruct.field.encodings.lattice import PermutohedralLattice
from koala3d.reconstruct.field.encodings.voxels import VoxelGrid
from koala3d.reconstruct.numerics.compiling import jit
from koala3d.reconstruct.rendering.compositing import composited
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.sampling.occupied_steps import OccupiedSteps
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation, Rays
from koala3d.reconstruct.scene.space import BOX

BOUNDED = Normalisation((0.0, 0.0, 0.0), 1.0, True, 2.0, 6.0)  # an object in the cube [-1, 1]^3, seen from four away
OCCUPIED = 0.03  # radius of the shell of occupied cells is 0.6; this is its half thickness [scene unit]


WORK = ("operations", "exponentials", "bytes", "gathers", "scatters")


@dataclass(frozen=True)
class Kernel:
    """One piece of a step."""

    name: str
    rays: int  # rays of the batch
    operations: float
    exponentials: float  # exponentials, error functions, sines, roots
    bytes: float
    gathers: float
    scatters: float
    seconds: float  # measured time

    def least(self, limits: dict[str, float]) -> tuple[float, str]:
        """Lower bound of the seconds by the machine's limits, and the name of the binding limit."""
        tables = {"gather, in the cache": self.gathers, "scatter, in the cache": self.scatters}
        amounts = {"matrix": self.operations, "exponential": self.exponentials, "stream": self.bytes, **tables}
        times = {name: amount / limits[name] for name, amount in amounts.items()}
        name = max(times, key=lambda key: times[key])
        return times[name], name


class Piece(NamedTuple):
    """A kernel before it is measured."""

    name: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    gathers: float = 0.0  # numbers looked up in tables
    scatters: float = 0.0  # numbers added to tables


@dataclass(frozen=True)
class Bench:
    """The kernels of a configuration's step, on a shell of occupied cells instead of a scene."""

    config: Config
    model: Model
    sampler: OccupiedSteps
    rays: Rays

    @classmethod
    def of(cls, config: Config) -> "Bench":
        """For a configuration with an occupancy grid."""
        grid = config.sampler.grid
        axis = (np.arange(grid) + 0.5) / grid * 2 - 1
        radius = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1), axis=-1).reshape(-1)
        possible = np.abs(radius - 0.6) < OCCUPIED
        model = Model.create(jax.random.key(0), config, SceneFacts(BOUNDED), possible=possible)
        assert isinstance(model.sampler, OccupiedSteps)  # the configuration has a grid
        return cls(config, model, model.sampler, _rays(model.sampler.rays_drawn * config.train.accumulate))

    def kernels(self, done: Callable[[str], None] = lambda name: None) -> list[Kernel]:
        """All kernels, measured one after the other; takes some seconds."""
        found = []
        for piece in self._pieces():
            found.append(self._measured(piece))
            done(piece.name)
        return found

    def _measured(self, piece: Piece) -> Kernel:
        arguments = piece.arguments
        compiled = jit(piece.function).lower(*arguments).compile()
        counted = compiled.cost_analysis() or {}
        seconds = fastest(lambda: compiled(*arguments))
        moved = sum(_bytes(leaf) for leaf in jax.tree.leaves((arguments, jax.eval_shape(piece.function, *arguments))))
        operations, exponentials = float(counted.get("flops", 0.0)), float(counted.get("transcendentals", 0.0))
        rays = self.sampler.rays_drawn * self.config.train.accumulate
        return Kernel(piece.name, rays, operations, exponentials, float(moved), piece.gathers, piece.scatters, seconds)

    def _pieces(self) -> list[Piece]:
        return [*self._choosing(), *self._encoding(), *self._networks(), *self._compositing(), *self._descending()]

    def _choosing(self) -> list[Piece]:
        sampler, (rays, depth, jitter) = self.sampler, self._kept()
        half = jnp.full(self.rays.origins.shape[0], 0.5)
        steps = half.size * depth.shape[-1]
        march = lambda s, r, j: s.expected_depth(r, j)  # noqa: E731
        pack = lambda d, r, j: sampler.packed(d, r, j, j, sampler.capacity)  # noqa: E731
        return [
            Piece("occupancy along rays", march, (sampler, self.rays, half), gathers=steps),
            Piece("choosing and packing", pack, (depth, rays, jitter), gathers=8 * sampler.capacity),
        ]

    def _encoding(self) -> list[Piece]:
        encoding, cloud = self.model.field.encoding, self._cloud()
        touched = float(cloud.points.shape[1] * corners(encoding) * encoding.num_channels)
        forward = lambda e, p: e(p, None)  # noqa: E731
        slopes = lambda e, p: e.value_and_jacobian(p, None)  # noqa: E731
        shape = jax.eval_shape(forward, encoding, cloud.points)
        pulled = jnp.ones(shape.shape)

        def backward(e, p, g):
            return jax.vjp(lambda e: forward(e, p), e)[1](g)

        small = cloud.points[:, : self.config.surface.rays * (self.config.surface.samples + 1)]
        share = small.shape[1] / cloud.points.shape[1]
        return [
            Piece("encoding", forward, (encoding, cloud.points), gathers=touched),
            Piece("encoding, backward alone", backward, (encoding, cloud.points, pulled), scatters=touched),
            Piece("encoding with slopes, second pass", slopes, (encoding, small), gathers=share * touched),
        ]

    def _networks(self) -> list[Piece]:
        field, rays = self.model.field, self.config.sampler.samples // 8
        appearance = field.appearance
        features = jnp.ones((field.encoding.num_channels, self.config.sampler.samples))
        spatial = lambda network, x: network(x)  # noqa: E731
        _, material = field(self._cloud())
        few = jax.tree.map(lambda a: a[:, :rays], material)
        directions = self.rays.viewdirs[:rays].T
        shade = lambda a, m, d: jnp.sum(a.shade(m, d).rgb)  # noqa: E731
        squared = lambda network, x: jnp.sum(jnp.square(network(x)))  # noqa: E731
        return [
            Piece("spatial network", spatial, (field.spatial, features)),
            Piece("spatial network, with backward", jax.grad(squared, argnums=(0, 1)), (field.spatial, features)),
            Piece("shading of rays", shade, (appearance, few, directions)),
            Piece("shading of rays, with backward", jax.grad(shade, argnums=(0, 1)), (appearance, few, directions)),
        ]

    def _compositing(self) -> list[Piece]:
        samples, rays = self._samples()
        channels = jnp.ones((10 + self.config.field.bottleneck, samples.t.shape[0]))

        def rendered(density, values):
            return jnp.sum(jnp.square(composited(density, (values,), samples, rays.speed)[1]))

        density, count = jnp.ones(samples.t.shape[0]), float(samples.t.shape[0])
        both_ways = count * (4 + len(channels))
        return [
            Piece("compositing", rendered, (density, channels), 2 * count, count * (2 + len(channels))),
            Piece("compositing, with backward", jax.grad(rendered, argnums=(0, 1)), (density, channels), both_ways, both_ways),
        ]

    def _descending(self) -> list[Piece]:
        adam = optax.scale_by_adam(b1=0.9, b2=0.99, eps=1e-15)

        def descend(gradient: Any, state: Any, model: Any) -> Any:
            update, state = adam.update(gradient, state)
            return jax.tree.map(lambda p, u: p - 0.01 * u, model, update), state

        model: Any = self.model.split()[0]
        return [Piece("optimiser", descend, (jax.tree.map(jnp.ones_like, model), adam.init(model), model))]

    def _samples(self):
        """Samples of the batch's rays through occupied cells, and those rays."""
        rays, depth, jitter = self._kept()
        samples, _ = self.sampler.packed(depth, rays, jitter, jitter, self.sampler.capacity)
        return samples, rays

    def _kept(self):
        """The rays that are packed, with their depths and jitter; those through empty space are dropped."""
        half = jnp.full(self.rays.origins.shape[0], 0.5)
        depth = self.sampler.expected_depth(self.rays, half)
        order = jnp.argsort(~jnp.any(depth > 0, -1))[: self.sampler.capacity // 8]
        return jax.tree.map(lambda a: a[order], (self.rays, depth, half))

    def _cloud(self) -> Cloud:
        """Random points of the shell, as many as a step has samples."""
        direction = jax.random.normal(jax.random.key(1), (3, self.config.sampler.samples))
        radius = 0.6 + OCCUPIED * jax.random.uniform(jax.random.key(2), (self.config.sampler.samples,), minval=-1)
        return Cloud(direction / jnp.linalg.norm(direction, axis=0) * radius, None, BOX)


def _bytes(leaf: Any) -> int:
    return int(np.prod(leaf.shape)) * leaf.dtype.itemsize


def corners(encoding: Encoding) -> int:
    """Vertices around a point."""
    return {PermutohedralLattice: 4, VoxelGrid: 8}.get(type(encoding), 0)


def _rays(count: int) -> Rays:
    """Rays of views whose middle the cube fills."""
    rng = np.random.default_rng(0)
    origins = rng.normal(size=(count, 3))
    origins *= 4 / np.linalg.norm(origins, axis=-1, keepdims=True)
    towards = rng.uniform(-0.9, 0.9, (count, 3)) - origins
    make = lambda a: jnp.asarray(a, jnp.float32)  # noqa: E731
    return Rays(make(origins), make(towards / 4), make(np.full(count, 1e-3)))


def rows(kernels: list[Kernel], limits: list[Limit]) -> list[dict[str, Any]]:
    """Each kernel with the lower bound of its time, the share of that in the measured time, and its work per ray."""
    rates = {limit.name: limit.rate for limit in limits}
    found = []
    for kernel in kernels:
        least, binding = kernel.least(rates)
        times = {"measured_ms": 1e3 * kernel.seconds, "least_ms": 1e3 * least, "limit": binding, "share": least / kernel.seconds}
        found.append({"kernel": kernel.name, **times, **{name: getattr(kernel, name) / kernel.rays for name in WORK}})
    return found


def text(found: list[dict[str, Any]]) -> str:
    """The rows as text."""
    widths = (11, 7, 8, 9, 9)
    work = "".join(f"{name:>{width}}" for name, width in zip(("operations", "exp", *WORK[2:]), widths, strict=True))
    lines = [f"{'kernel':<36}{'measured':>10}{'allowed':>10}{'share':>8}  {'limit':<22}{work}   (per ray)"]
    for row in found:
        times = f"{row['measured_ms']:>7.2f} ms{row['least_ms']:>7.2f} ms{100 * row['share']:>6.0f} %"
        work = "".join(f"{row[name]:>{width}.0f}" for name, width in zip(WORK, widths, strict=True))
        lines.append(f"{row['kernel']:<36}{times}  {row['limit']:<22}{work}")
    return "\n".join(lines)
