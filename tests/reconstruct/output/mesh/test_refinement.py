import numpy as np
import pytest
import trimesh
from skimage.measure import marching_cubes

from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.output.mesh import refinement
from koala3d.reconstruct.output.mesh.refinement import follow_normals

OVER = 0.05


def equilateral(length: float, width: float, side: float) -> tuple[np.ndarray, np.ndarray]:
    """A flat strip of equilateral triangles from x = 0 to `length`: (v, 2) places and (f, 3) faces.

    All cotangents are equal, so that the discrete Laplacian is exact to second order in `side`.
    """
    columns, rows = round(length / side) + 1, round(width / (side * np.sqrt(0.75))) + 1
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    places = np.stack([side * (column + 0.5 * (row % 2)), side * np.sqrt(0.75) * row], -1).reshape(-1, 2)
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    odd = (row[:-1, :-1] % 2 == 1)[..., None, None]
    faces = np.where(odd, np.stack([np.stack([a, b, d], -1), np.stack([a, d, c], -1)], -2),
                     np.stack([np.stack([a, b, c], -1), np.stack([b, d, c], -1)], -2))  # fmt: skip
    return places, faces.reshape(-1, 3)


@pytest.mark.parametrize("wavelength", [0.1, 0.3, 1.0])
def test_a_wave_that_the_normals_deny_is_damped_as_the_theory_says(wavelength: float) -> None:
    """The minimum of d^2 + L^2 |grad(z + d)|^2 for z = a cos(kx) is z + d = z / (1 + L^2 k^2)."""
    places, faces = equilateral(1.0, 0.2, 0.01)
    wave = 2 * np.pi / wavelength
    vertices = np.column_stack([places, 1e-5 * np.cos(wave * places[:, 0])])
    found = follow_normals(vertices, faces, np.tile([0.0, 0.0, 1.0], (len(vertices), 1)), over=OVER)
    inner = (np.abs(places[:, 0] - 0.5) < 0.25) & (np.abs(places[:, 1] - 0.1) < 0.05)
    expected = vertices[inner, 2] / (1 + (OVER * wave) ** 2)
    # Second order: 1/12 (k h)^2 of the damping, 3 % at ten triangles a wave; the strip's ragged ends add a hundredth.
    assert np.abs(found[inner, 2] - expected).max() < 1e-5 * (0.01 + (wave * 0.01) ** 2 / 12)
    np.testing.assert_array_equal(found[:, :2], vertices[:, :2])


def rough_ball(noise: float) -> tuple[trimesh.Trimesh, np.ndarray]:
    """A unit ball whose vertices are moved in and out at random, and the true normals."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    normals = np.array(ball.vertices)
    ball.vertices *= 1 + noise * np.random.default_rng(0).standard_normal((len(normals), 1))
    return ball, normals


def test_noise_goes_and_the_size_stays() -> None:
    """Edges are 0.07 long: over 0.3, the root mean square of white noise falls to about h / (sqrt(4 pi) L) = 0.07."""
    ball, normals = rough_ball(0.003)
    found = np.linalg.norm(follow_normals(ball.vertices, ball.faces, normals, over=0.3), axis=-1)
    assert np.std(found) < 0.1 * 0.003
    assert abs(np.mean(found) - 1) < 3 * 0.003 / np.sqrt(len(found))  # the mean of the noise, three standard deviations


def test_it_knows_no_unit_and_no_direction() -> None:
    ball, normals = rough_ball(0.003)
    turn = trimesh.transformations.rotation_matrix(1.0, [1, 2, 3])[:3, :3]
    found = follow_normals(ball.vertices, ball.faces, normals, over=0.3)
    moved = follow_normals(20 * ball.vertices @ turn.T + 5, ball.faces, normals @ turn.T, over=6.0)
    np.testing.assert_allclose((moved - 5) / 20 @ turn, found, atol=1e-6)  # of displacements of 3e-3, to the solver's tolerance


def test_normals_that_contradict_the_mesh_are_not_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The normals of a patch of a ball are tilted by 60 degrees: least squares would move it, edges without weight do not."""
    ball, normals = rough_ball(0.0)
    tilted = np.where(normals[:, 2:] > 0.8, 0.5 * normals + np.sqrt(0.75) * np.array([1.0, 0.0, 0.0]), normals)
    tilted /= np.linalg.norm(tilted, axis=-1, keepdims=True)
    moved = lambda: np.abs(follow_normals(ball.vertices, ball.faces, tilted, over=0.3) - ball.vertices).max()  # noqa: E731
    robust = moved()
    monkeypatch.setattr(refinement, "CREASE", np.inf)
    assert robust < 0.2 * moved()


def test_triangles_without_area_do_no_harm() -> None:
    """As marching cubes makes them, where the surface runs through a grid point."""
    ball, normals = rough_ball(0.003)
    edge = ball.edges_unique[0]
    vertices = np.vstack([ball.vertices, ball.vertices[edge[:1]]])
    faces = np.vstack([ball.faces, [[edge[0], edge[1], len(ball.vertices)]]])
    found = follow_normals(vertices, faces, np.vstack([normals, normals[edge[:1]]]), over=0.3)
    assert np.std(np.linalg.norm(found, axis=-1)) < 0.1 * 0.003


def test_needles_do_not_fold_over(monkeypatch: pytest.MonkeyPatch) -> None:
    """Marching cubes leaves needles where a rough ball runs close by a grid point; left alone, 44 of them would turn over."""
    axis = np.linspace(-1.2, 1.2, 60)
    field = 1 - np.sqrt(sum(x**2 for x in np.meshgrid(axis, axis, axis, indexing="ij")))
    field += 0.02 * np.random.default_rng(0).standard_normal(field.shape)
    vertices, faces, _, _ = marching_cubes(field, 0.0, spacing=(axis[1] - axis[0],) * 3, gradient_direction="ascent")
    vertices = vertices + axis[0]
    normals = vertices / np.linalg.norm(vertices, axis=-1, keepdims=True)

    def folded() -> int:
        moved = follow_normals(vertices, faces, normals, over=0.1)
        before, after = (trimesh.Trimesh(v, faces, process=False).triangles_cross for v in (vertices, moved))
        return int((np.sum(before * after, -1) < 0).sum())

    assert folded() == 0
    monkeypatch.setattr(refinement, "ROUNDS", 0)
    assert folded() > 20


def test_what_is_not_finite_is_said() -> None:
    ball, normals = rough_ball(0.003)
    normals[7, 1] = np.nan
    with pytest.raises(ReconstructError, match=r"1 of its 2562 normals are not finite.*--density-only"):
        follow_normals(ball.vertices, ball.faces, normals, over=0.3)
