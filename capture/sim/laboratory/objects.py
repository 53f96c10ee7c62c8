"""Objects of the simulated laboratory other than the golden head: a mirror ball, the inside of a lidar, crystals.

Each function returns parts, one mesh [m] per material, that stand on z = 0 around the origin. All are computed from a seed.
"""

from collections.abc import Sequence

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from koala3d.capture.sim.laboratory.materials import Glass, Material, Matt, Metal, Plastic

Part = tuple[str, trimesh.Trimesh, Material, bool]  # name, mesh, material, and whether the mesh carries smooth normals
SECTIONS = 96  # number of sides of round parts


def shiny_ball() -> list[Part]:
    """A mirror ball of 10 cm radius."""
    return [("ball", trimesh.creation.icosphere(subdivisions=6, radius=0.1), Metal("Ag", 0.03), True)]


def lidar_guts(rng: np.random.Generator) -> list[Part]:
    """A lidar without its cover: milled aluminium, steel pillars, two circuit boards, a coil, a lens in its barrel."""
    board, chips, pads = _board(rng, (0.15, 0.11), 26)
    upright, more_chips, more_pads = _board(rng, (0.09, 0.06), 9)
    stand = trimesh.transformations.concatenate_matrices(
        trimesh.transformations.translation_matrix([-0.055, 0.0, 0.078]),
        trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1]),
        trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]),
    )
    for mesh in (upright, more_chips, more_pads):
        mesh.apply_transform(stand)
    for mesh in (board, chips, pads):
        mesh.apply_translation([0, 0, 0.030])
    aluminium = [
        _box((0.18, 0.14, 0.010), (0, 0, 0.005)),
        *(_box((0.006, 0.14, 0.020), (side * 0.087, 0, 0.020)) for side in (-1, 1)),
        _ring(0.020, 0.034, 0.040, (0.035, 0.0, 0.056)),
        _ring(0.034, 0.038, 0.006, (0.035, 0.0, 0.079)),
        _ring(0.0005, 0.012, 0.012, (0.035, 0.0, 0.082)),
    ]
    pillars = [_rod(0.004, 0.020, (x, y, 0.020)) for x in (-0.066, 0.066) for y in (-0.046, 0.046)]
    coil = [trimesh.creation.torus(0.014, 0.0022, transform=_at((0.035, 0.0, 0.042 + 0.0046 * turn))) for turn in range(3)]
    barrel = [
        _ring(0.0165, 0.020, 0.030, (-0.005, -0.048, 0.062), along="y"),
        _ring(0.019, 0.023, 0.006, (-0.005, -0.062, 0.062), along="y"),
        _box((0.030, 0.022, 0.020), (-0.005, -0.040, 0.040)),
    ]
    lens = _lens(0.0165, 0.007)
    lens.apply_transform(_at((-0.005, -0.060, 0.062), along="-y"))
    return [
        ("aluminium", joined(aluminium), Metal("Al", 0.16), False),
        ("pillars", joined(pillars), Metal("Cr", 0.1), False),
        ("coil", joined(coil), Metal("Cu", 0.2), False),
        ("boards", joined([board, upright]), Plastic((0.02, 0.16, 0.06), 0.15), False),
        ("chips", joined([chips, more_chips, *barrel]), Plastic((0.02, 0.02, 0.022), 0.2), False),
        ("pads", joined([pads, more_pads]), Metal("Au", 0.15), False),
        ("lens", lens, Glass(1.52), False),
    ]


def crystal_capture(rng: np.random.Generator) -> list[Part]:
    """Quartz crystals, hexagonal prisms with pyramids on top, on a matt stone."""
    stone = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    waves = (0.05 * np.sin(stone.vertices @ rng.normal(0, 3.5, 3) + rng.uniform(0, 6)) for _ in range(6))
    bumps = sum(waves, np.zeros(len(stone.vertices)))
    stone = trimesh.Trimesh(stone.vertices * (1 + bumps)[:, None] * [0.10, 0.09, 0.028], stone.faces, process=False)
    stone.vertices[:, 2] = np.maximum(stone.vertices[:, 2] + 0.006, 0.0)
    crystals = [_crystal(rng, 0.024, 0.175, np.zeros(2), 0.10)]
    for index in range(7):
        angle = 2 * np.pi * (index + rng.uniform(-0.2, 0.2)) / 7
        place = rng.uniform(0.048, 0.060) * np.array([np.cos(angle), 0.9 * np.sin(angle)])
        crystals.append(_crystal(rng, rng.uniform(0.012, 0.018), rng.uniform(0.08, 0.13), place, rng.uniform(0.25, 0.5)))
    return [
        ("stone", stone, Matt(np.array([0.20, 0.17, 0.15], np.float32)), False),
        ("crystals", joined(crystals), Glass(1.544), False),
    ]


def mug() -> list[Part]:
    """A mug of 8 cm by 9.5 cm with a handle: thick lacquer on its wall, a foot ring below, hollow above."""
    outside = [(0.0, 0.004), (0.024, 0.004), (0.026, 0.0), (0.030, 0.0), (0.032, 0.004), (0.038, 0.016), (0.040, 0.03)]
    inside = [(0.040, 0.092), (0.0385, 0.095), (0.036, 0.092), (0.036, 0.02), (0.030, 0.009), (0.0, 0.008)]
    body = trimesh.creation.revolve(np.array(outside + inside), sections=2 * SECTIONS)
    bend, around = (grid.ravel() for grid in np.meshgrid(np.linspace(-1.75, 1.75, 49), np.linspace(0, 2 * np.pi, 32, False)))
    away = 0.024 + 0.0055 * np.cos(around)
    points = np.stack([0.043 + away * np.cos(bend), 0.0055 * np.sin(around), 0.052 + 1.25 * away * np.sin(bend)], -1)
    row, column = (grid.ravel() for grid in np.meshgrid(np.arange(32), np.arange(48), indexing="ij"))
    corner = lambda down, right: (row + down) % 32 * 49 + column + right  # noqa: E731
    faces = [np.stack([corner(0, 0), corner(0, 1), corner(1, 1)], -1), np.stack([corner(0, 0), corner(1, 1), corner(1, 0)], -1)]
    ends = [[0, *range(31 * 49, 0, -49)], [48, *range(48 + 49, 32 * 49, 49)]]
    caps = [[end[0], end[i], end[i + 1]] for end in ends for i in range(1, 31)]
    handle = trimesh.Trimesh(points, np.concatenate([*faces, caps]), process=False)
    handle.fix_normals()
    return [("mug", joined([body, handle]), Plastic((0.03, 0.09, 0.30), 0.08), False)]


def _crystal(rng: np.random.Generator, radius: float, height: float, place: NDArray[np.float64], lean: float) -> trimesh.Trimesh:
    """One crystal with its foot at (2,) `place`, leaning outwards by `lean` [rad]."""
    sides = np.arange(6) * np.pi / 3 + rng.uniform(0, np.pi / 3)
    around = np.stack([np.cos(sides), np.sin(sides)], -1) * (radius * rng.uniform(0.85, 1.15, 6))[:, None]
    shoulder = height - 1.3 * radius
    foot, top = np.column_stack([around, np.full(6, 0.006)]), np.column_stack([around * 0.94, np.full(6, shoulder)])
    points = np.concatenate([foot, top, [[0.15 * radius * rng.normal(), 0.15 * radius * rng.normal(), height]]])
    mesh = trimesh.convex.convex_hull(points)
    away = place / max(float(np.linalg.norm(place)), 1e-9) if np.linalg.norm(place) > 0 else np.array([1.0, 0.0])
    mesh.apply_transform(trimesh.transformations.rotation_matrix(lean, [-away[1], away[0], 0]))
    mesh.apply_translation([*place, 0.004])
    mesh.vertices[:, 2] = np.maximum(mesh.vertices[:, 2], 0.001)
    return trimesh.convex.convex_hull(mesh.vertices)


def _board(
    rng: np.random.Generator, size: tuple[float, float], count: int
) -> tuple[trimesh.Trimesh, trimesh.Trimesh, trimesh.Trimesh]:
    """A circuit board around the origin, its black components, and gold contacts along one edge."""
    thickness = 0.0016
    board = _box((*size, thickness), (0, 0, 0))
    chips, taken = [], []
    for _ in range(60 * count):
        edges = rng.choice([[0.022, 0.022, 0.0025], [0.012, 0.008, 0.002], [0.006, 0.004, 0.003], [0.004, 0.008, 0.006]])
        corner = (np.array(size) - edges[:2]) / 2 - [0.006, 0.012]
        place = rng.uniform(-corner, corner)
        if len(chips) < count and all(
            (np.abs(place - other) > (edges[:2] + extent) / 2 + 0.002).any() for other, extent in taken
        ):
            taken.append((place, edges[:2]))
            chips.append(_box(edges, (*place, (thickness + edges[2]) / 2)))
    steps = np.arange(-size[0] / 2 + 0.012, size[0] / 2 - 0.010, 0.004)
    pads = [_box((0.0022, 0.006, 0.0004), (x, -size[1] / 2 + 0.005, thickness / 2 + 0.0001)) for x in steps]
    return board, joined(chips), joined(pads)


def _lens(radius: float, bulge: float) -> trimesh.Trimesh:
    """A plano-convex lens: the flat side on z = 0, the other a cap of height `bulge`."""
    sphere = (radius**2 + bulge**2) / (2 * bulge)
    across = np.linspace(0, radius, 32)
    cap = np.sqrt(sphere**2 - across**2) - (sphere - bulge)
    profile = np.concatenate([[[0.0, -0.002]], [[radius, -0.002]], np.stack([across, cap], -1)[::-1]])
    return trimesh.convex.convex_hull(trimesh.creation.revolve(profile, sections=SECTIONS).vertices)


def _at(place: ArrayLike, along: str = "z") -> NDArray[np.float64]:
    """(4, 4) transform that moves a part to a place and turns its z axis along another axis."""
    turn = {"z": (0.0, [1, 0, 0]), "y": (-np.pi / 2, [1, 0, 0]), "-y": (np.pi / 2, [1, 0, 0])}[along]
    matrix = trimesh.transformations.rotation_matrix(*turn)
    matrix[:3, 3] = place
    return matrix


def _box(edges: ArrayLike, place: ArrayLike) -> trimesh.Trimesh:
    return trimesh.creation.box(np.asarray(edges), transform=_at(place))


def _rod(radius: float, height: float, place: ArrayLike) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius, height, sections=SECTIONS, transform=_at(place))


def _ring(inner: float, outer: float, height: float, place: ArrayLike, along: str = "z") -> trimesh.Trimesh:
    return trimesh.creation.annulus(inner, outer, height, sections=SECTIONS, transform=_at(place, along))


def joined(parts: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """All parts as one mesh."""
    mesh = trimesh.util.concatenate(list(parts))
    assert isinstance(mesh, trimesh.Trimesh)  # as all its parts are
    return mesh
