"""What a step trains on: rays drawn from the pixels, divided among the devices."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import jax
import numpy as np
from jaxtyping import Array, Bool, PRNGKeyArray

from koala3d.datasets.core.console import hint
from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.numerics.compiling import barrier
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.sampling.sampler import Batch
from koala3d.reconstruct.scene.rays import Pixels
from koala3d.reconstruct.scene.twists import moved
from koala3d.reconstruct.training.distributed import on_all

Tree = TypeVar("Tree")


@dataclass(frozen=True)
class Division:
    """The devices among which each batch is divided."""

    mesh: jax.sharding.Mesh | None = None
    """None for one device."""

    @classmethod
    def among(cls, devices: Sequence[Any], sizes: tuple[int, ...]) -> "Division":
        """As many of the devices as divide arrays of these lengths evenly.

        Raises:
            UsageError: the devices are of several processes, none of which can be left out, and do not divide every batch.
        """
        count = math.gcd(len(devices), *sizes)
        if count < len(devices) and len({device.process_index for device in devices}) > 1:
            raise UsageError(
                f"{len(devices)} devices do not divide a batch evenly",
                where="sampler.rays and sampler.samples",
                why=", ".join(map(str, sorted(set(sizes)))),
                remedy="choose multiples, or another number of processes",
            )
        if count < len(devices):
            hint(f"{count} of {len(devices)} devices are used: more do not divide sampler.rays and sampler.samples evenly")
        return cls(None if count == 1 else jax.sharding.Mesh(np.array(devices[:count]), ("rays",)))

    @property
    def everywhere(self) -> jax.sharding.NamedSharding | None:
        """How states lie on the devices: whole on each. None for one device."""
        return None if self.mesh is None else jax.sharding.NamedSharding(self.mesh, jax.sharding.PartitionSpec())

    def divided(self, pixels: Pixels) -> Pixels:
        """The pixels in equal parts, one on each device; what there is of each view is everywhere. As they are for one device."""
        if self.mesh is None or self.everywhere is None:
            return pixels
        part = jax.sharding.NamedSharding(self.mesh, jax.sharding.PartitionSpec(*self.mesh.axis_names))
        pixels = pixels.filled(-(-len(pixels.view) // self.mesh.size) * self.mesh.size, len(pixels.origins))
        tables = [np.asarray(a) for a in (pixels.colour, pixels.directions, pixels.view)]
        kept: tuple[Any, ...] = on_all((pixels.origins, pixels.radii, pixels.light, pixels.count), self.everywhere)
        divided: list[Any] = on_all(tables, part)
        return Pixels(*divided, *kept)

    def spread(self, tree: Tree) -> Tree:
        """The arrays of a batch divided among the devices along their first axis; everything else is everywhere."""
        if self.mesh is None:
            return tree
        part = jax.sharding.NamedSharding(self.mesh, jax.sharding.PartitionSpec(*self.mesh.axis_names))
        return jax.tree.map(lambda a: jax.lax.with_sharding_constraint(a, part), tree)

    def spread_evenly(self, tree: Tree) -> Tree:
        """The same where all of the arrays' lengths can be divided; elsewhere everything stays as it is."""
        even = self.mesh is not None and all(leaf.shape[0] % self.mesh.size == 0 for leaf in jax.tree.leaves(tree))
        return self.spread(tree) if even else tree


ONE_DEVICE = Division()


def drawn_batch(
    model: Model, pixels: Pixels, pixel_key: PRNGKeyArray, sample_key: PRNGKeyArray, looks: Bool[Array, ""], division: Division
) -> Batch:
    """Random pixels, their rays as the corrected cameras see them, and the samples that the sampler chooses as data."""
    index = model.sampler.pixels(pixels, pixel_key)
    rays, colour = barrier(division.spread(pixels.take(barrier(index))))  # each device adds what it has of the pixels
    rays = moved(rays, model.twists)
    return barrier(division.spread(model.sampler.batch(rays, colour, sample_key, model.field, looks)))
