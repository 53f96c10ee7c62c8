import numpy as np
import trimesh
from trimesh.triangles import closest_point

from koala3d.reconstruct.output.mesh.nearest import Nearest


def slow(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Distance by trying every triangle."""
    return np.min(
        [np.linalg.norm(closest_point(np.tile(one, (len(points), 1, 1)), points) - points, axis=-1) for one in mesh.triangles], 0
    )


def test_distances_are_those_of_the_closest_triangle() -> None:
    """Long triangles, small ones, and an edge between faces; points on the surface, near it and far away."""
    ball = trimesh.creation.icosphere(2, radius=0.5).apply_scale([3, 1, 0.1])
    mesh = trimesh.util.concatenate([trimesh.creation.box((2.0, 0.4, 0.1)), ball.apply_translation([0, 0, 0.4])])
    rng = np.random.default_rng(0)
    on = trimesh.sample.sample_surface(mesh, 300, seed=1)[0]
    near, far = np.concatenate([on, on + 0.02 * rng.normal(size=on.shape), mesh.vertices]), rng.normal(size=(100, 3))
    nearest = Nearest(mesh, count=500)
    feet = nearest.feet(near)
    np.testing.assert_allclose(feet.distance, slow(mesh, near), atol=1e-9)
    np.testing.assert_allclose(nearest.feet(far).distance, slow(mesh, far), rtol=2e-3)  # another foot may be almost as close
    np.testing.assert_allclose(np.linalg.norm(near - feet.points, axis=-1), feet.distance, atol=1e-12)
    np.testing.assert_allclose(nearest.at(feet, np.asarray(mesh.vertices)), feet.points, atol=1e-9)
    assert not nearest.on_an_edge(feet).any()


def test_where_a_surface_ends_is_told() -> None:
    plate = (
        trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
        .subdivide()
        .subdivide()
    )
    nearest = Nearest(plate, count=1000)
    feet = nearest.feet(np.array([[0.5, 0.5, 0.1], [1.5, 0.5, 0.1], [-0.1, 0.3, 0.0]]))
    assert nearest.on_an_edge(feet).tolist() == [False, True, True]
