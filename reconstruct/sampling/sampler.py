"""What every sampler does, so that nobody else needs to know which one a model has."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray
from numpy.typing import NDArray

from koala3d.datasets.scene import View
from koala3d.datasets.structure.masks.silhouette import Slack
from koala3d.reconstruct.config import Config, SamplerConfig
from koala3d.reconstruct.field.encodings.encoding import Encoding
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.sampling.proposals import Level
from koala3d.reconstruct.sampling.samples import Footprint, RaySamples
from koala3d.reconstruct.scene.bounds import Bounds
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation, Pixels, Rays
from koala3d.reconstruct.scene.space import Space


class Batch(eqx.Module):
    """Rays that a step trains on, with the samples that were chosen before anything is differentiated."""

    rays: Rays
    colour: Float[Array, "rays 4"]
    """Of the rays' pixels: sRGB and alpha."""
    used: Bool[Array, " rays"]
    """False for rays that meet nothing or found no room: they take no part."""
    samples: RaySamples | None
    """None where samples depend on what is differentiated."""


class Sampled(eqx.Module):
    """Samples on rays."""

    samples: RaySamples
    footprint: Footprint
    fits: Bool[Array, " rays"]
    """False for rays that found no room for all of their samples."""
    edges: Float[Array, "rays edges"] | None = None
    """Normalised edges of the samples' intervals; only with `levels`."""
    levels: tuple[Level, ...] = ()
    """Proposals that are to follow the weights of these samples."""


class Sampler(eqx.Module):
    """Where along a ray a field is evaluated. Part of a model: what it has learned, and what it keeps up to date.

    `batch` and `sampled` are two steps of training: the first chooses rays, and samples where these are data; the second is
    differentiated. `unjittered` serves pictures and leaves nothing to chance.
    """

    space: eqx.AbstractVar[Space]
    """Where the field lives."""
    bounds: eqx.AbstractVar[Bounds]
    frustum: eqx.AbstractVar[str]
    """What stands for a sample's frustum, see `Footprint`."""

    rules_out_space: ClassVar[bool]
    """Whether it knows empty cells, from masks and from training."""
    memory_grows_with_rays: ClassVar[bool]
    """Whether a step's memory grows with its rays."""

    @classmethod
    @abstractmethod
    def create(
        cls, key: PRNGKeyArray, config: Config, facts: SceneFacts, possible: NDArray[Any] | None, density_bias: float
    ) -> "Sampler":
        """A fresh sampler. `possible`: what `possible_cells` returned."""

    @classmethod
    @abstractmethod
    def possible_cells(
        cls, config: Config, pixels: Pixels, views: tuple[View, ...], normalisation: Normalisation, slack: Sequence[Slack] | None
    ) -> NDArray[Any] | None:
        """Cells that can hold anything; None where none is ruled out.

        Args:
            slack: how far each view's camera may be from where the view has it [scene unit], and turned [rad]; None: not
                at all.
        """

    @property
    @abstractmethod
    def rays_drawn(self) -> int:
        """Rays drawn for a batch, those that meet nothing included."""

    @property
    @abstractmethod
    def samples_drawn(self) -> int:
        """Samples of a batch, those included that fill a list."""

    @property
    @abstractmethod
    def divided_sizes(self) -> tuple[int, ...]:
        """Lengths of the arrays that several devices divide among themselves."""

    @classmethod
    def frustum_of(cls, config: SamplerConfig) -> str:
        """What stands for a sample's frustum, see `Footprint`."""
        return "point"

    @abstractmethod
    def pixels(self, pixels: Pixels, key: PRNGKeyArray) -> Int[Array, " drawn"]:
        """Indices of the pixels that a batch begins with."""

    @abstractmethod
    def batch(self, rays: Rays, colour: Float[Array, "rays 4"], key: PRNGKeyArray, field: Field, looks: Bool[Array, ""]) -> Batch:
        """The rays worth training on. `looks`: whether the field is asked where light ends, see `ends_early`."""

    @abstractmethod
    def sampled(self, batch: Batch, key: PRNGKeyArray) -> Sampled:
        """Samples of a batch; differentiable to what the sampler learns."""

    @abstractmethod
    def unjittered(self, rays: Rays) -> Sampled:
        """Samples of rays for a picture, in rows (`RaySamples.in_rows`): nothing is left to chance."""

    @property
    def encodings(self) -> tuple[Encoding, ...]:
        """Encodings that it learns."""
        return ()

    def ends_early(self, lit: float) -> bool:
        """Whether to leave out what is behind the end of light, when it reaches so many samples of a ray."""
        return False

    def met(self, batch: Batch, density: Float[Array, " n"]) -> Any:
        """What a step has found out in passing, for `with_met`; None where nothing is kept."""
        return None

    def with_met(self, met: Any) -> "Sampler":
        """The same with what a step has found out."""
        return self

    def upkeep_due(self, since: int, progress: float) -> bool:
        """Whether `upkept` is due, `since` steps after the last time. False throughout where there is nothing to keep up."""
        return False

    def upkept(self, field: Field, key: PRNGKeyArray) -> "Sampler":
        """The same, brought up to date with the field."""
        return self

    def figures(self) -> dict[str, float]:
        """What the log says of it."""
        return {}

    def near_occupied(self, axes: tuple[NDArray[Any], ...]) -> NDArray[Any] | None:
        """(x, y, z) True for points of a grid with these axes at which there may be matter; None: anywhere."""
        return None
