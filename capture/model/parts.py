"""The shape of an arm and of what it carries: a capsule along each part, that is all points within a radius of a line segment.

Lengths in metres. Each part moves with one link of the arm and is given in that link's frame.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Part:
    """One part: a capsule that a link carries."""

    name: str
    radius: float
    link: int  # number of joints between the base and this part
    start: Array  # (3,) one end of the capsule's axis in the frame of the link [m]
    end: Array  # (3,) the other one
    neighbours: int = 2  # parts at most this many joints away always touch it, or cannot
    checks_table: bool = True  # whether it could reach the table or the ceiling
    checks_object: bool = True  # whether it could reach the object and other bodies
    can_hide: bool = True  # whether it could be between the camera and the object


@dataclass(frozen=True)
class Shape:
    """The parts of an arm and of what it carries, in the order from the base to the camera."""

    parts: tuple[Part, ...]

    @cached_property
    def index(self) -> dict[str, int]:
        """Place of each part, by name."""
        return {part.name: place for place, part in enumerate(self.parts)}

    @cached_property
    def radii(self) -> Array:
        """(parts,) radii [m]."""
        return np.array([part.radius for part in self.parts])

    @cached_property
    def pairs(self) -> list[tuple[int, int]]:
        """Places of two parts that could collide with each other, the one farther from the base first."""
        found = []
        for first in range(len(self.parts) - 1, -1, -1):
            for second in range(first):
                one, other = self.parts[first], self.parts[second]
                if abs(one.link - other.link) > min(one.neighbours, other.neighbours):
                    found.append((first, second))
        return found

    def segments(self, frames: Array) -> Array:
        """(..., parts, 2, 3) both ends of the axis of each part in the base [m].

        Args:
            frames: (..., n + 1, 4, 4) poses of the links, as `datasets.kinematics.link_frames` gives them.
        """
        ends = np.array([[part.start, part.end] for part in self.parts])
        carriers = frames[..., [part.link for part in self.parts], :, :]
        return ends @ np.swapaxes(carriers[..., :3, :3], -1, -2) + carriers[..., None, :3, 3]
