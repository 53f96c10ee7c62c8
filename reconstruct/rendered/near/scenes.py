"""What stands in the near scenes, and their lamps. Frozen: whoever changes their images raises `EDITION` of `shiny`.

As the shiny ones they lie inside a ball of 0.12 m about the origin, among cameras at 0.6 m. The lamps hang just behind these.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from koala3d.reconstruct.rendered.light import Light
from koala3d.reconstruct.rendered.near.materials import (
    Coated,
    Glass,
    Material,
    Matte,
    Metal,
    Partly,
    above,
    chequers,
    patches,
    plain,
    veins,
)
from koala3d.reconstruct.rendered.shiny import CHROME
from koala3d.reconstruct.rendered.solids import Distance, ball, blended, block, placed, puck, rod, torus
from koala3d.reconstruct.rendered.tracer import Body, Tracer

LAMPS = 3
LAMP_DISTANCE, LAMP_RADIUS = 5.6, 0.5
"""From the centre, and a lamp's own [radius of the scene]: 0.67 m and 0.06 m."""
ROOM = 0.5
"""Brightness of the distant light, as a share of that of the shiny scenes."""


@dataclass(frozen=True)
class Part:
    """One solid of one material."""

    solid: Distance
    material: Material


@dataclass(frozen=True)
class Lamp:
    """A glowing ball."""

    place: tuple[float, float, float]
    colour: tuple[float, float, float]
    """Radiance."""


@dataclass(frozen=True)
class NearScene:
    """Solids under near lamps in a room."""

    parts: tuple[Part, ...]
    seed: int
    """Of the lamps and of the room."""

    @cached_property
    def room(self) -> Light:
        """Distant light."""
        return Light.studio(self.seed)

    @cached_property
    def lamps(self) -> tuple[Lamp, ...]:
        """At random angles around the scene and above it, from warm to cold."""
        rng = np.random.default_rng(self.seed)
        found = []
        for number in range(LAMPS):
            angle, height = 2 * np.pi * (number + 0.6 * rng.random()) / LAMPS, rng.uniform(0.2, 0.9)
            across = np.sqrt(1 - height**2)
            place = LAMP_DISTANCE * np.array([across * np.cos(angle), across * np.sin(angle), height])
            warm = rng.uniform(-0.25, 0.25)
            colour = rng.uniform(25, 45) * np.array([1 + warm, 1.0, 1 - warm])
            found.append(Lamp(tuple(place.tolist()), tuple(colour.tolist())))
        return tuple(found)

    def shape(self) -> Tracer:
        """Traces rays against the solids; what it knows of light is not used."""
        return Tracer(tuple(Body(part.solid, CHROME) for part in self.parts), self.room)


def steel_kettle() -> NearScene:
    """A brushed belly under a thin polished handle, which mirror each other; a matte knob."""
    belly = placed(blended(0.2, ball(0.46), puck(0.44, 0.22, 0.1)), (0.0, 0.0, -0.24))
    handle = placed(torus(0.5, 0.035), (0.0, 0.0, 0.12), (90, 0, 20))
    spout = rod((0.3, 0.1, -0.2), (0.78, 0.26, 0.16), 0.06)
    knob = placed(ball(0.11), (0.0, 0.0, 0.3))
    return NearScene(
        (
            Part(belly, Metal("Cr", 0.06, across=0.3)),
            Part(handle, Metal("Ag", 0.05)),
            Part(spout, Metal("Cr", 0.1)),
            Part(knob, Matte(plain(0.25, 0.03, 0.03))),
        ),
        11,
    )


def lacquered_egg() -> NearScene:
    """A chequered pattern below a clear coat."""
    egg = blended(0.5, placed(ball(0.56), (0.0, 0.0, -0.16)), placed(ball(0.36), (0.0, 0.0, 0.34)))
    return NearScene((Part(egg, Coated((0.6, 0.45, 0.1), (0.05, 0.12, 0.4), chequers(9.0), 0.03)),), 12)


def glass_and_copper() -> NearScene:
    """A ball of glass beside a block of rough copper on a matte plate: what one shows is the other, and both cast shadows."""
    plate = placed(puck(0.85, 0.05, 0.03), (0.0, 0.0, -0.42))
    glass = placed(ball(0.3), (-0.36, 0.0, -0.06))
    copper = placed(block((0.22, 0.22, 0.32), 0.06), (0.34, 0.05, -0.04), (0, 0, 30))
    return NearScene(
        (
            Part(plate, Matte(patches((0.55, 0.5, 0.42), (0.2, 0.22, 0.25), 8.0))),
            Part(glass, Glass(1.5)),
            Part(copper, Metal("Cu", 0.2)),
        ),
        13,
    )


def painted_stones() -> NearScene:
    """Matte stones with veins that touch: shadows, light from one to the other, nothing that mirrors."""
    low = blended(0.3, placed(ball(0.4), (-0.32, 0.1, -0.26)), placed(ball(0.3), (0.1, -0.12, -0.36)))
    high = blended(
        0.25, placed(ball(0.28), (0.12, 0.14, 0.24)), placed(block((0.26, 0.2, 0.2), 0.12), (0.36, 0.2, -0.1), (20, 10, 0))
    )
    return NearScene(
        (
            Part(low, Matte(veins((0.7, 0.62, 0.5), (0.18, 0.1, 0.06), 9.0))),
            Part(high, Matte(veins((0.12, 0.3, 0.34), (0.7, 0.72, 0.6), 11.0))),
        ),
        14,
    )


def half_mirror() -> NearScene:
    """One smooth solid, polished silver above a wavy line and matte with a pattern below it."""
    pebble = blended(0.6, placed(ball(0.5), (-0.14, 0.0, 0.0)), placed(ball(0.44), (0.24, 0.08, 0.06)))
    pattern = patches((0.65, 0.3, 0.12), (0.15, 0.2, 0.1), 10.0)
    return NearScene((Part(pebble, Partly(pattern, Metal("Ag", 0.04), above(0.02, 0.02))),), 15)


_MADE = (steel_kettle, lacquered_egg, glass_and_copper, painted_stones, half_mirror)
NEAR: dict[str, Callable[[], NearScene]] = {made.__name__: made for made in _MADE}
