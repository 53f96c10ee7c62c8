import itertools

import jax
import jax.numpy as jnp
import numpy as np

from koala3d.reconstruct.field.encodings import simplex
from koala3d.reconstruct.numerics.compiling import barrier

SCALE = 3.7


def lifted(points: np.ndarray) -> np.ndarray:
    """(n, 4) float64 coordinates in the plane, by the matrix, of points times SCALE."""
    return SCALE * np.asarray(points, np.float64).T @ (4 * simplex.LIFT.T)


@jax.jit
def search(points: jax.Array) -> dict[str, jax.Array]:
    """Vertices (4 vertices, 4 coordinates, n), ranks, weights and their slopes, as the module gives them.

    Barriers stand where the encoding has them: else the compiler may lift a point twice, with other last digits, and a
    point halfway between two integers is rounded in two ways.
    """
    e = barrier(simplex.lift(*(points * SCALE)))
    code = barrier(simplex.ordering(e))
    ranks = jnp.stack([simplex.rank_of(code, i) for i in range(4)])
    origins = jnp.stack([simplex.origin_of(e, code, i) for i in range(4)])
    corners = jnp.stack([4 * origins + k - 4 * (ranks > 3 - k) for k in range(4)])
    slopes = jnp.stack([jnp.stack(one) for one in simplex.weight_slopes(code, np.array([SCALE], np.float32))])
    return {
        "e": jnp.stack(e),
        "corners": corners,
        "ranks": ranks,
        "weights": jnp.stack(simplex.barycentric(e, code)),
        "slopes": slopes,
    }


def corners_of(points: jax.Array) -> np.ndarray:
    """(n, 4 vertices, 4 coordinates) integers."""
    return np.asarray(search(points)["corners"]).transpose(2, 0, 1)


def is_lattice_point(v: np.ndarray) -> np.ndarray:
    """All coordinates of equal remainder mod 4 and of sum zero: the definition of A3*, times four."""
    return (v.sum(-1) == 0) & (v % 4 == v[..., :1] % 4).all(-1)


def nearby_lattice_points(e: np.ndarray) -> np.ndarray:
    """Every point of the scaled A3* whose coordinates lie within 4 of those of e, by enumeration."""
    ranges = [range(int(np.floor(c)) - 4, int(np.ceil(c)) + 5) for c in e]
    candidates = np.array(list(itertools.product(*ranges[:3])))
    candidates = np.concatenate([candidates, -candidates.sum(-1, keepdims=True)], -1)
    return candidates[is_lattice_point(candidates) & (np.abs(candidates - e).max(-1) <= 4)]


def test_the_lift_is_an_isometry_times_its_scale(points: jax.Array) -> None:
    matrix = 4 * simplex.LIFT
    np.testing.assert_allclose(matrix.T @ matrix, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.ones(4) @ matrix, 0, atol=1e-12)
    np.testing.assert_allclose(4 * np.asarray(search(points)["e"]).T, lifted(points), atol=4e-6)  # float32 of size 10


def test_vertices_are_lattice_points_and_weights_reproduce_the_point(points: jax.Array) -> None:
    found, corners = search(points), corners_of(points)
    assert is_lattice_point(corners).all()
    np.testing.assert_array_equal(np.sort(found["ranks"], 0), np.arange(4)[:, None] * np.ones((1, points.shape[1])))
    weights = np.asarray(found["weights"]).T
    assert weights.min() >= -1e-6  # float32 rounding of coordinates of size 10, over 4
    np.testing.assert_allclose(weights.sum(-1), 1, atol=1e-6)
    np.testing.assert_allclose(np.einsum("nk,nkc->nc", weights, corners), lifted(points), atol=1e-5)


def test_the_simplex_is_the_delaunay_cell_found_by_enumeration(points: jax.Array) -> None:
    """A3*'s simplices are its Delaunay cells (Conway and Sloane 1988): no other lattice point lies within the circumsphere."""
    for e, corners in zip(lifted(points)[:60], corners_of(points)[:60], strict=True):
        a = 2 * (corners[1:] - corners[0])
        b = (corners[1:] ** 2).sum(-1) - (corners[0] ** 2).sum()
        centre = np.linalg.lstsq(np.vstack([a, np.ones(4)]), np.append(b, 0), rcond=None)[0]
        radius = np.linalg.norm(corners - centre, axis=-1)
        np.testing.assert_allclose(radius, radius[0], atol=1e-9)
        near = nearby_lattice_points(e)
        assert len(near) > 8, "the enumeration must offer alternatives"
        distance = np.linalg.norm(near - centre, axis=-1)
        assert distance.min() >= radius[0] - 1e-9
        inside = np.linalg.lstsq(np.vstack([corners.T, np.ones(4)]), np.append(e, 1), rcond=None)[0]
        assert inside.min() >= -1e-5, "the point lies in the cell"


def test_slopes_are_the_derivatives_of_the_weights(points: jax.Array) -> None:
    """Weights solve a linear system with the simplex's vertices; so do their derivatives, exactly."""
    slopes = np.asarray(search(points)["slopes"])  # (axis, vertex, n)
    lift = 4 * SCALE * simplex.LIFT
    for index, corners in enumerate(corners_of(points)):
        system = np.vstack([corners.T, np.ones(4)])
        expected = np.linalg.lstsq(system, np.vstack([lift, np.zeros(3)]), rcond=None)[0]
        np.testing.assert_allclose(slopes[:, :, index], expected.T, atol=1e-5)  # float32 of values up to 4


def test_vertices_edges_and_facets_have_weights() -> None:
    corners = np.array([[0, 0, 0, 0], [1, 1, 1, -3], [2, 2, -2, -2], [3, -1, -1, -1], [4, 0, 0, -4]], float)
    assert is_lattice_point(corners.astype(int)).all()
    exact = np.concatenate([corners, (corners[:-1] + corners[1:]) / 2, (corners[:3] + corners[1:4] + corners[[3, 3, 4]]) / 3])
    places = np.float32(np.linalg.pinv(4 * SCALE * simplex.LIFT) @ exact.T)
    found = {name: np.asarray(one)[..., : len(exact)] for name, one in search(np.resize(places.T, (400, 3)).T.copy()).items()}
    weights = found["weights"]
    assert weights.min() >= -1e-6
    np.testing.assert_allclose(weights.sum(0), 1, atol=1e-6)
    np.testing.assert_allclose(np.sort(weights[:, :5].T, -1), [[0, 0, 0, 1]] * 5, atol=1e-6)
    np.testing.assert_allclose(np.einsum("kn,kcn->nc", weights, found["corners"]), exact, atol=1e-5)
    assert np.isfinite(found["slopes"]).all()
