import numpy as np

from koala3d.capture.sim.laboratory.head import head_distance, head_mesh


def test_head_is_one_closed_solid_that_stands_flat():
    mesh = head_mesh()
    assert mesh.is_watertight and mesh.body_count == 1 and mesh.volume > 0
    lower, upper = mesh.bounds
    assert abs(lower[2]) < 5e-4 and 0.24 < upper[2] < 0.27  # metres: the height of a small bust
    assert np.ptp(mesh.vertices[mesh.vertices[:, 2] < 1e-3, 0]) > 0.08  # a plinth, not a point


def test_normals_point_outward_and_agree_with_the_facets():
    mesh = head_mesh()
    normals = np.asarray(mesh.vertex_normals)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    facet = np.einsum("ij,ij->i", normals[mesh.faces].mean(1), mesh.face_normals)
    assert np.mean(facet > 0.8) > 0.97  # all but creases finer than the grid


def test_distance_is_negative_inside_only():
    inside = np.array([[0, 0, 15], [-1, 0, 6], [-0.8, 0, 1]], np.float32)
    outside = np.array([[12, 0, 15], [0, 9, 15], [0, 0, 27.5], [5.0, 0, 5]], np.float32)
    assert (head_distance(inside) < 0).all() and (head_distance(outside) > 0).all()


def test_face_is_where_it_should_be():
    """Along the middle: the nose stands out before brow, lips and chin."""

    def front(height: float) -> float:
        x = np.arange(12, 0, -0.02, dtype=np.float32)
        points = np.stack([x, np.zeros_like(x), np.full_like(x, height)], -1)
        return float(x[np.argmax(head_distance(points) < 0)])

    brow, nose, lips, chin = front(17.2), front(13.9), front(12.0), front(9.2)
    assert nose > max(brow, lips, chin) + 0.5 and min(brow, lips, chin) > 5.0
