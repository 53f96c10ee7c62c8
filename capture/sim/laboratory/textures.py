"""Procedural textures of the simulated laboratory, computed from a seed."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Picture = NDArray[np.float32]


def noise(height: int, width: int, cells: int, rng: np.random.Generator) -> Picture:
    """(height, width) smooth random values in 0..1, with about `cells` maxima along each axis."""
    from scipy.ndimage import zoom

    coarse = rng.random((cells + 3, cells + 3)).astype(np.float32)
    fine = np.asarray(zoom(coarse, (height / cells, width / cells), order=3))
    return np.clip(fine[:height, :width], 0, 1)


def mixed(first: ArrayLike, second: ArrayLike, share: Picture) -> Picture:
    """(height, width, 3) mixture of two colours: `second` where `share` (height, width) is 1."""
    return np.asarray((1 - share[..., None]) * np.asarray(first) + share[..., None] * np.asarray(second), np.float32)


def table_top(rng: np.random.Generator, resolution: int = 1024) -> Picture:
    """Matt table top: large soft stains, planks and a fine grain, so that every place looks different."""
    shape = (resolution, resolution)
    colour = mixed((0.22, 0.17, 0.13), (0.42, 0.36, 0.28), noise(*shape, 9, rng))
    colour = mixed(colour, (0.16, 0.26, 0.30), 0.7 * noise(*shape, 14, rng) ** 3)
    colour = mixed(colour, (0.45, 0.22, 0.14), 0.6 * noise(*shape, 18, rng) ** 4)
    grain = 0.85 + 0.3 * noise(*shape, 60, rng)
    plank = (np.arange(resolution) * 12 // resolution)[:, None] * np.ones(shape, np.int64)
    shade = rng.uniform(0.85, 1.1, 13)[plank]
    return np.clip(colour * (grain * shade)[..., None], 0.02, 0.9).astype(np.float32)


def room(rng: np.random.Generator, height: int = 128) -> Picture:
    """(height, 2 * height, 3) radiance of the surroundings, latitude by longitude, first row at the zenith.

    A dim laboratory: grey ceiling, walls whose colour drifts around the room, dark floor, a few bright panels and
    windows with soft borders. All of it is reflected in metal.
    """
    width = 2 * height
    rows, columns = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    turn = 2 * np.pi * columns
    drift = np.stack([0.5 + 0.5 * np.sin(turn + phase) for phase in rng.uniform(0, 2 * np.pi) + np.array([0, 2.1, 4.2])], -1)
    walls = 0.10 + 0.22 * drift
    ceiling, floor = np.array([0.30, 0.31, 0.33]), np.array([0.07, 0.065, 0.06])
    picture = walls + _step(0.28 - rows)[..., None] * (ceiling - walls)
    picture = picture + _step(rows - 0.56)[..., None] * (floor - picture)
    panels = [  # centre row, column; half height, half width; radiance
        (0.20, 0.10, 0.07, 0.05, (7.0, 6.6, 6.0)),
        (0.24, 0.42, 0.05, 0.09, (5.0, 5.3, 5.8)),
        (0.22, 0.70, 0.08, 0.04, (6.0, 5.4, 4.6)),
        (0.40, 0.86, 0.06, 0.03, (2.6, 3.2, 4.2)),
        (0.42, 0.28, 0.05, 0.025, (3.0, 2.2, 1.4)),
        (0.06, 0.50, 0.04, 0.30, (3.0, 3.0, 3.0)),
    ]
    for row, column, half_height, half_width, radiance in panels:
        beside = np.abs((columns - column + 0.5) % 1 - 0.5)
        inside = _step(half_height - np.abs(rows - row)) * _step(half_width - beside)
        picture = picture + inside[..., None] * np.asarray(radiance)
    return np.asarray(picture, np.float32)


AMBIENT = 0.15
"""What is left of the laboratory's light when its lamps are switched off: windows and screens."""
LAMP = (24.0, 23.0, 21.0)
"""Radiance of a switched lamp."""


def lit(surroundings: Picture, burning: tuple[bool, ...]) -> Picture:
    """Surroundings like those of `room` when their own light is switched off and some of the lamps are on.

    The lamps are panels of equal size, spread evenly around the room, half-way up.
    """
    height, width = surroundings.shape[:2]
    rows, columns = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    picture = AMBIENT * surroundings.astype(np.float64)
    for number, on in enumerate(burning):
        beside = np.abs((columns - (number + 0.5) / len(burning) + 0.5) % 1 - 0.5)
        inside = _step(0.08 - np.abs(rows - 0.27)) * _step(0.04 - beside)
        picture += on * inside[..., None] * np.asarray(LAMP)
    return np.asarray(picture, np.float32)


def brightness(burning: tuple[bool, ...]) -> float:
    """Light on evenly lit things under some of the lamps, relative to all; the second lamp is twice as bright, and so on."""
    shares = np.arange(1, len(burning) + 1) / max(sum(range(1, len(burning) + 1)), 1)
    return float(AMBIENT + (1 - AMBIENT) * (shares @ np.asarray(burning, np.float64)))


def _step(signed: NDArray[np.float64], softness: float = 0.012) -> NDArray[np.float64]:
    """0 where `signed` is well below zero, 1 well above, smooth between."""
    share = np.clip(signed / softness * 0.5 + 0.5, 0, 1)
    return share * share * (3 - 2 * share)
