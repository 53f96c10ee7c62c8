"""Where a field lives: the map from the scene to the coordinates that encodings and the occupancy grid take.

A `Box` is all there is to see; a `Ball` holds an object and, contracted, what is around it; a `Frustum` (its own file) is what
cameras see that all look the same way.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

from koala3d.reconstruct.scene import contraction

Points = Float[Array, "*batch 3"]
Coordinate = Float[Array, "*batch"]


class Space(ABC):
    """A map of the scene. Hashable: it is static where programs are compiled."""

    bounded: bool = False
    """Whether everything lies in the cube [-1, 1]^3."""
    single_grid: bool = True
    """Whether the map leads into that cube; else into the ball of radius 2, whose inner half is the scene itself."""

    @abstractmethod
    def mapped(self, points: Points) -> Points:
        """Coordinates of scene points."""

    @abstractmethod
    def mapped_coordinates(self, x: Coordinate, y: Coordinate, z: Coordinate) -> tuple[Coordinate, Coordinate, Coordinate]:
        """`mapped` of three arrays, for hot loops: not safe to differentiate."""

    @abstractmethod
    def scale(self, points: Points) -> Coordinate:
        """By how much the map scales a small Gaussian's width at scene points."""

    @abstractmethod
    def pull_back(self, points: Points, gradient: Points) -> Points:
        """Gradient to scene coordinates from one to the map's, at scene `points`: the transposed Jacobian applied.

        The gradient may have axes in front of those of the points.
        """

    def around(self, points: Points) -> Points:
        """Places relative to the object, finite everywhere: for what starts differently around it."""
        return self.mapped(points)


@dataclass(frozen=True)
class Box(Space):
    """The cube [-1, 1]^3 as it is."""

    bounded = True

    def mapped(self, points: Points) -> Points:
        """The same."""
        return points

    def mapped_coordinates(self, x: Coordinate, y: Coordinate, z: Coordinate) -> tuple[Coordinate, Coordinate, Coordinate]:
        """The same."""
        return x, y, z

    def scale(self, points: Points) -> Coordinate:
        """One."""
        return jnp.ones(points.shape[:-1])

    def pull_back(self, points: Points, gradient: Points) -> Points:
        """The same."""
        return gradient


@dataclass(frozen=True)
class Ball(Space):
    """The unit ball as it is, and all that is outside contracted into the ball of radius 2; see `contraction`."""

    single_grid = False

    def mapped(self, points: Points) -> Points:
        """See `contraction.contract`."""
        return contraction.contract(points)

    def mapped_coordinates(self, x: Coordinate, y: Coordinate, z: Coordinate) -> tuple[Coordinate, Coordinate, Coordinate]:
        """See `contraction.contract_coordinates`."""
        return contraction.contract_coordinates(x, y, z)

    def scale(self, points: Points) -> Coordinate:
        """See `contraction.contraction_scale`."""
        return contraction.contraction_scale(points)

    def pull_back(self, points: Points, gradient: Points) -> Points:
        """See `contraction.pull_back`."""
        return contraction.pull_back(points, gradient)


BOX, BALL = Box(), Ball()
