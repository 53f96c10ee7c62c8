"""Every primitive in float32 against float64 over its domain, finite with a finite derivative there and beyond.

Each row of `ROWS` stands in docs/numerics.md word for word; `test_the_document_says_what_is_tested` holds them together.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.field.cloud import _perpendicular, gaussians_in_frustums
from koala3d.reconstruct.field.encodings.directional import integrated_directional_encoding, view_encoding
from koala3d.reconstruct.field.encodings.frequencies import Frequencies
from koala3d.reconstruct.field.encodings.lattice import PermutohedralLattice, ball_share
from koala3d.reconstruct.field.encodings.simplex import VERTICES_PER_UNIT_VOLUME
from koala3d.reconstruct.field.encodings.voxels import VoxelGrid, cube_share
from koala3d.reconstruct.field.parallax import ends_on_sphere
from koala3d.reconstruct.numerics import stepfun
from koala3d.reconstruct.numerics.lattice_constants import LIFT
from koala3d.reconstruct.numerics.safe import linear_from_srgb, normalise, safe_exp, safe_norm, srgb_from_linear
from koala3d.reconstruct.numerics.volume import volume_weights
from koala3d.reconstruct.sampling.drawing import draw_probability
from koala3d.reconstruct.sampling.steps import Steps
from koala3d.reconstruct.scene.contraction import contract, contraction_scale, pull_back
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import BALL, BOX
from koala3d.reconstruct.surface import first_surface, regularisers
from koala3d.reconstruct.training import losses
from koala3d.reconstruct.training.schedule import encoding_blur, learning_rate

DOCUMENT = Path(__file__).parents[2] / "docs" / "numerics.md"
RNG = np.random.default_rng(0)
SIGNED = np.concatenate([[0.0], np.geomspace(1e-30, 1e30, 61), -np.geomspace(1e-30, 1e30, 61)])
POSITIVE = np.concatenate([[0.0], np.geomspace(1e-30, 1e30, 121)])
UNIT = np.linspace(0, 1, 101)
DIRECTIONS = RNG.normal(size=(200, 3)) / np.sqrt(3)
DIRECTIONS = np.concatenate([np.eye(3), -np.eye(3), DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=-1, keepdims=True)])
VECTORS = (DIRECTIONS[:, None] * np.concatenate([[0.0], np.geomspace(1e-25, 1e30, 56)])[:, None]).reshape(-1, 3)
SEAM = (DIRECTIONS[:, None] * (1 + np.array([0, 1e-7, -1e-7, 1e-4, -1e-4, 0.5, -0.5]))[:, None]).reshape(-1, 3)
LIMITED = (np.roll(DIRECTIONS, 7, 0)[:, None] * np.array([0, 1e-6, 0.1, 0.5, 0.89, 0.91, 1, 1e6])[:, None]).reshape(-1, 3)
HISTOGRAM = np.sort(RNG.random((64, 17)), -1)
HISTOGRAM[:8, 4:9] = HISTOGRAM[:8, 4:5]  # intervals of no length
HISTOGRAM[8:16] = 0.5  # and rays of none
SHARES = RNG.dirichlet(np.full(16, 0.3), 64) * RNG.random((64, 1))
SHARES[16:24] = 0.0
LENGTHS = np.abs(np.diff(HISTOGRAM, axis=-1)) * np.repeat([1e-6, 1.0, 1e6, 1e12], 16)[:, None]
DENSITIES = RNG.choice([0.0, 1e-30, 1e-3, 1.0, 1e3, 1e30], (64, 16))
COLOURS = RNG.random((12, 8, 3)) * np.array([0, 1e-12, 1e-4, 1])[np.arange(12) % 4, None, None]
BALLS = np.concatenate([DIRECTIONS[:96].reshape(12, 8, 3)])
PINS = np.float64(np.float32([1e-6, 1e-3, 1.0, 1e3, 1e6]))
MIDDLES, HALVES = (grid.ravel() for grid in np.meshgrid(PINS, np.concatenate([[0.0], PINS]), indexing="ij"))
CORNERS = np.linalg.inv((LIFT * 4)[:3]) @ (4.0 * RNG.integers(-3, 4, (3, 60)))  # vertices of the lattice, in its units
LATTICED = np.concatenate(
    [CORNERS, (CORNERS[:, 1:] + CORNERS[:, :-1]) / 2, (CORNERS[:, 2:] + CORNERS[:, 1:-1] + CORNERS[:, :-2]) / 3], 1
)
PLACES = np.concatenate(
    [LATTICED / VERTICES_PER_UNIT_VOLUME / 8, RNG.uniform(-2, 2, (3, 200)), RNG.integers(-2, 3, (3, 60)) / 8.0], 1
)
GRID = dict(levels=3, features=2, log2_size=10, coarsest=2.0, finest=32.0)


@dataclass(frozen=True)
class Row:
    """A primitive, where it was tried, and how far float32 may be from float64: |difference| <= relative * |value| + absolute."""

    name: str
    function: Callable[..., Any]
    inputs: tuple[Any, ...]
    domain: str
    relative: float
    absolute: float
    reason: str
    beyond: tuple[Any, ...] | None = None
    """Inputs at which value and derivative need only be finite."""

    def document(self) -> str:
        return f"| {self.name} | {self.domain} | {self.relative:.0e} | {self.absolute:.0e} | {self.reason} |"


def grid_values(kind: type) -> Callable[[jax.Array], Any]:
    """Value and slopes of a small grid whose table is of order one; the slopes over the resolution."""
    made = kind.create(jax.random.key(0), **GRID)
    table = np.asarray(1e4 * made.table, np.float64)

    def evaluate(points: jax.Array) -> jax.Array:
        return kind(jnp.asarray(table, points.dtype), jnp.zeros((), points.dtype), made.resolutions, made.log2_size)(points)

    return evaluate


def frustums(t: jax.Array, half: jax.Array) -> Any:
    """Mean and deviation along and across of frustums of a ray along z, as multiples of their distance."""
    one = jnp.ones((1,), t.dtype)
    rays = Rays(jnp.zeros((1, 3), t.dtype), jnp.asarray([[0.0, 0, 1]], t.dtype), 1e-3 * one)
    cloud = gaussians_in_frustums(rays, jnp.zeros(t.shape, jnp.int32), t, half, BOX)
    return cloud.points[2] / (t + half), cloud.scale[0] / (t + half), cloud.scale[2] / (t + half)


def steps_of(directions: jax.Array, near: float) -> Any:
    """Where a ray through the cube is cut, from a camera four units away that looks along `directions`."""
    rays = Rays(-4 * directions, directions, jnp.ones(directions.shape[0], directions.dtype))
    steps = Steps.of(rays, steps=32, space=BALL, near=near, far=1e3)
    return steps.at(jnp.broadcast_to(jnp.arange(0, steps.count + 1, 8, dtype=directions.dtype), (directions.shape[0], 17)))


ROWS = [
    Row(
        "safe_exp",
        safe_exp,
        (SIGNED,),
        "all numbers; saturates at 15",
        2e-6,
        1e-38,
        "exp's error is that of its argument, 15 ulp",
    ),
    Row("safe_norm", safe_norm, (VECTORS,), "lengths 0, 1e-25 to 1e30", 5e-7, 1e-30, "a root of three squares"),
    Row(
        "normalise",
        normalise,
        (VECTORS[np.linalg.norm(VECTORS, axis=-1) > 1e-11],),
        "lengths 1e-11 to 1e30",
        0,
        3e-7,
        "each component has 2 ulp of the length",
        (VECTORS,),
    ),
    Row(
        "srgb_from_linear",
        srgb_from_linear,
        (np.concatenate([UNIT, [0.0031308, 0.0031309, -0.5], PINS]),),
        "-0.5 to 1e6",
        1e-6,
        1e-7,
        "the power's error",
        (POSITIVE,),
    ),
    Row(
        "linear_from_srgb",
        linear_from_srgb,
        (np.concatenate([UNIT, [0.04045, 0.040451, -0.5], PINS]),),
        "-0.5 to 1e6",
        3e-6,
        1e-7,
        "the power's error: a logarithm of 14 times 2.4",
        (POSITIVE[POSITIVE < 1e15],),
    ),
    Row("contract", contract, (np.concatenate([VECTORS, SEAM]),), "lengths 0 to 1e30, the seam", 0, 5e-7, "2 ulp at length 2"),
    Row(
        "contraction_scale",
        contraction_scale,
        (np.concatenate([VECTORS, SEAM]),),
        "lengths 0 to 1e30, the seam",
        3e-6,
        1e-37,
        "the power -4/3 of up to 1e30: 4/3 ulp of its logarithm",
    ),
    Row(
        "pull_back",
        lambda p: pull_back(p, jnp.ones_like(p)),
        (np.concatenate([VECTORS[np.abs(VECTORS).max(-1) < 1e6], SEAM]),),
        "lengths 0 to 1e6, the seam",
        0,
        2e-6,
        "a difference of unit vectors",
        (VECTORS,),
    ),
    Row(
        "power_ladder",
        lambda x: stepfun.power_ladder(x, -1.5, 2.0),
        (POSITIVE,),
        "0 to 1e30, p = -1.5",
        2e-6,
        1e-37,
        "log1p, expm1",
    ),
    Row(
        "inverse_power_ladder",
        lambda y: stepfun.inverse_power_ladder(y, -1.5, 2.0),
        (np.linspace(0, 1.6, 200),),
        "0 to 0.96 of its end",
        5e-5,
        1e-7,
        "the slope near the end: 25 times its argument's error",
        (np.array([1.6, 1.667, 2, 1e6, -1.0]),),
    ),
    Row(
        "sum_of_boxes_cdf",
        lambda x: stepfun.sum_of_boxes_cdf(x, jnp.abs(x[::-1]), 0.06),
        (np.linspace(-2, 2, 401),),
        "widths 0 to 2, x from -2 to 2",
        0,
        1e-5,
        "differences of order 1 over a width of at least 0.06",
    ),
    Row(
        "resample_blurred",
        lambda t, w: stepfun.resample_blurred(jnp.broadcast_to(jnp.linspace(0, 1, 33, dtype=t.dtype), (64, 33)), t, w, 0.03),
        (HISTOGRAM, SHARES),
        "intervals of no length, all weights zero",
        0,
        1e-5,
        "as above, 16 weights that add up to one",
    ),
    Row(
        "sample_intervals",
        lambda t, w: stepfun.sample_intervals(jnp.full(64, 0.4, t.dtype), t, w + 0.01, 8),
        (HISTOGRAM, SHARES),
        "intervals of no length, rays of none",
        0,
        3e-5,
        "1 ulp of the distribution over a density of 0.01",
        (HISTOGRAM, 0 * SHARES),
    ),
    Row(
        "volume_weights",
        lambda d, s: volume_weights(d * s),
        (DENSITIES, LENGTHS),
        "densities 0 to 1e30, lengths 0 to 1e12",
        2e-6,
        2e-6,
        "the exponent, up to 80, in ulp; beyond that nothing is seen",
    ),
    Row(
        "draw_probability",
        lambda d: draw_probability(d, 8),
        (np.repeat(RNG.choice([0, 1e-4, 0.02, 1.0], (64, 32)), 1, 0),),
        "depths 0 to 1 per step, empty rays",
        1e-5,
        1e-6,
        "sums of 32",
        (np.zeros((4, 32)),),
    ),
    Row(
        "Steps",
        lambda d: steps_of(d, 1e-6),
        (DIRECTIONS,),
        "directions along axes and between, near 1e-6, far 1e3",
        1e-3,
        2e-6,
        "disparity: the furthest steps share the last digits of 1e-3",
    ),
    Row(
        "neighbourhood_radius",
        lambda t, h: first_surface.neighbourhood_radius(jnp.full_like(t, 1e-3), t, h),
        (MIDDLES, HALVES),
        "t and its half width 1e-6 to 1e6",
        1e-6,
        0,
        "sums of squares",
    ),
    Row(
        "gaussians_in_frustums",
        frustums,
        (MIDDLES, np.minimum(HALVES, MIDDLES)),
        "t and its half width 1e-6 to 1e6",
        5e-3,
        1e-6,
        "the length along the ray is a difference that cancels for long frustums",
    ),
    Row(
        "perpendicular",
        _perpendicular,
        (DIRECTIONS,),
        "all directions, along -z and z = 0 too",
        0,
        5e-7,
        "products of order 1",
        (np.array([[0.0, 0, -1], [1e-8, 0, -1], [0, 0, 1]]),),
    ),
    Row(
        "lattice",
        grid_values(PermutohedralLattice),
        (PLACES,),
        "points in tetrahedra, on facets, edges and vertices",
        0,
        3e-5,
        "1 ulp of the position times the resolution, 32, times the slope",
        (np.full((3, 4), [0.0, 1e-30, 2.0, 1e6]),),
    ),
    Row(
        "voxels",
        grid_values(VoxelGrid),
        (PLACES,),
        "points in cells, on faces, edges and vertices",
        0,
        3e-5,
        "as for the lattice",
        (np.full((3, 4), [0.0, 1e-30, 2.0, 1e6]),),
    ),
    Row(
        "frequencies",
        Frequencies.create(levels=16, coarsest=1.0, finest=2.0**15),
        (PLACES,),
        "to 2^15 rad per unit, points to 2",
        0,
        5e-3,
        "1 ulp of the angle, 2^16 rad",
        (np.full((3, 2), [1e-30, 1e6]),),
    ),
    Row(
        "ball_share",
        lambda s: ball_share(s, np.float32([[2.0], [2048.0]])),
        (np.concatenate([[0.0], np.geomspace(1e-12, 1e6, 400)]),),
        "deviations 0 to 1e6",
        2e-5,
        1e-37,
        "a difference down to 1/25 of its terms, a series below",
    ),
    Row(
        "cube_share",
        lambda s: cube_share(s, np.float32([[2.0], [2048.0]])),
        (np.concatenate([[0.0], np.geomspace(1e-12, 1e6, 400)]),),
        "deviations 0 to 1e6",
        2e-6,
        1e-37,
        "erf's error",
    ),
    Row(
        "directional encoding to l = 16",
        lambda d, r: integrated_directional_encoding(d.T, r, 5),
        (DIRECTIONS, np.resize([0, 1e-6, 1e-3, 0.1, 1, 1e6], len(DIRECTIONS))),
        "all directions, poles too, roughness 0 to 1e6",
        0,
        2e-5,
        "the recurrence adds an ulp of its largest term per degree",
    ),
    Row(
        "ends_on_sphere",
        lambda d, x: ends_on_sphere(d.T, x.T),
        (np.repeat(DIRECTIONS, 8, 0), LIMITED),
        "all directions, places to 1e6 radii",
        0,
        2e-6,
        "a root of 0.19 or more",
    ),
    Row("view_encoding", lambda d: view_encoding(d.T, 4), (DIRECTIONS,), "all directions", 0, 2e-6, "1 ulp of an angle of 8"),
    Row(
        "charbonnier",
        lambda e: losses.charbonnier(e, 1e-3),
        (SIGNED[np.abs(SIGNED) < 1e18],),
        "errors to 1e18",
        3e-7,
        0,
        "a root",
    ),
    Row(
        "interlevel",
        lambda t, w: losses.interlevel(t, w),
        (SHARES, SHARES[::-1].copy()),
        "weights zero, alike, disjoint",
        3e-6,
        1e-6,
        "16 quotients by at least 1e-5",
        (SHARES, 0 * SHARES),
    ),
    Row(
        "distortion",
        lambda m, w: losses.distortion(w, m, jnp.ones_like(w) / 16),
        (HISTOGRAM[:, 1:], SHARES),
        "intervals of no length, all weights zero",
        0,
        1e-6,
        "running sums of order 1",
        (1e6 * HISTOGRAM[:, 1:], SHARES),
    ),
    Row(
        "hollowness",
        lambda d, w: losses.hollowness(w, d),
        (DENSITIES, SHARES),
        "densities 0 to 1e30, rays of no weight",
        3e-6,
        1e-7,
        "products of running sums of order 1",
        (1e-40 * DENSITIES, SHARES),
    ),
    Row(
        "fog",
        lambda m, w: losses.fog(w, m, jnp.ones_like(w) / 16, jnp.full(w.shape[0], 9)),
        (HISTOGRAM[:, 1:], SHARES),
        "rays of no weight, samples in one place",
        0,
        1e-6,
        "a sum of order 1",
        (1e6 * HISTOGRAM[:, 1:], SHARES),
    ),
    Row(
        "orientation",
        lambda n, d: losses.orientation(n.T, d.T),
        (DIRECTIONS, DIRECTIONS[::-1].copy()),
        "parallel, across, opposite",
        0,
        1e-6,
        "a product of order 1",
        (0 * DIRECTIONS, DIRECTIONS),
    ),
    Row(
        "density_smoothness",
        lambda d, o: regularisers.density_smoothness(d, o, o[:, 0], jnp.full(12, 0.01, d.dtype), "tangent"),
        (DENSITIES[:12, :8], BALLS),
        "densities 0 to 1e30, offsets along the normal",
        2e-6,
        1e-6,
        "expm1, a mean",
    ),
    Row(
        "normal_consistency",
        lambda n: regularisers.normal_consistency(n, n[:, 0]),
        (BALLS,),
        "alike, across, opposite",
        0,
        1e-6,
        "a mean of order 1",
        (0 * BALLS,),
    ),
    Row(
        "lambertian_bias",
        regularisers.lambertian_bias,
        (COLOURS,),
        "black to saturated, all alike",
        2e-6,
        1e-12,
        "squares of quotients",
        (0 * COLOURS,),
    ),
    Row(
        "metal_or_not",
        lambda c: regularisers.metal_or_not(c[:, 0], c),
        (COLOURS,),
        "black to saturated, all alike",
        2e-6,
        1e-6,
        "a quotient of means",
        (0 * COLOURS,),
    ),
    Row(
        "specular_variation",
        lambda c, d: regularisers.specular_variation(c, regularisers.direction_likeness(d), 3),
        (COLOURS, BALLS),
        "black to saturated, directions alike",
        2e-6,
        1e-6,
        "differences of order 1",
        (0 * COLOURS, 0 * BALLS),
    ),
    Row(
        "learning_rate",
        jax.vmap(lambda p: learning_rate(p, rate=0.01, final_rate=1e-3, warmup=0.02)),
        (UNIT,),
        "0 to 1",
        5e-6,
        0,
        "exp of a logarithm of 1e-10",
        (np.array([-1.0, 2.0]),),
    ),
    Row(
        "encoding_blur",
        jax.vmap(lambda p: encoding_blur(p, first=0.02, last=1e-3, until=0.5)),
        (UNIT,),
        "0 to 1",
        2e-6,
        0,
        "exp of a logarithm",
    ),
]


def evaluated(row: Row, inputs: tuple[Any, ...], dtype: Any) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Values, and derivatives of their sum to every input; without the compiler's optimisations, which here only take time."""
    arrays = [jnp.asarray(np.asarray(a, np.float32), dtype) for a in inputs]

    def both(*arguments):
        total = lambda *a: sum(jnp.sum(leaf) for leaf in jax.tree.leaves(row.function(*a)))  # noqa: E731
        return row.function(*arguments), jax.grad(total, tuple(range(len(arguments))))(*arguments)

    compiled = jax.jit(both).lower(*arrays).compile(compiler_options={"xla_backend_optimization_level": 0})
    values, slopes = compiled(*arrays)
    return [np.asarray(v) for v in jax.tree.leaves(values)], [np.asarray(s) for s in slopes]


@pytest.mark.parametrize("row", ROWS, ids=[row.name for row in ROWS])
def test_float32_is_near_float64_and_the_derivative_finite(row: Row) -> None:
    values, slopes = evaluated(row, row.inputs, jnp.float32)
    with jax.enable_x64(True):
        exact, _ = evaluated(row, row.inputs, jnp.float64)
    for value, truth in zip(values, exact, strict=True):
        assert value.dtype == np.float32 and truth.dtype == np.float64
        assert np.isfinite(value).all()
        excess = np.abs(value - truth) - row.relative * np.abs(truth)
        assert excess.max() <= row.absolute, (
            f"off by {excess.max():.2g} beyond the relative bound, where the value is {truth.ravel()[excess.argmax()]:.3g}"
        )
    for slope in slopes:
        assert np.isfinite(slope).all()
    for leaf in (leaf for part in evaluated(row, row.beyond, jnp.float32) for leaf in part) if row.beyond else ():
        assert np.isfinite(leaf).all(), "beyond the domain"


def test_the_document_says_what_is_tested() -> None:
    written = DOCUMENT.read_text(encoding="utf-8")
    missing = [row.document() for row in ROWS if row.document() not in written]
    assert not missing, "docs/numerics.md lacks\n" + "\n".join(missing)
