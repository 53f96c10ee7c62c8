import jax.numpy as jnp
import numpy as np

from koala3d.reconstruct.field.solid import Solid


def test_an_object_is_solid_in_its_box_and_as_solid_as_it_is_by_now() -> None:
    points = jnp.asarray([[0.0, 0.29, 0.31, 0.0], [0.0, -0.19, 0.0, 0.0], [0.0, 0.39, 0.0, -0.41]])
    solid = Solid.within((0.3, 0.2, 0.4))
    np.testing.assert_array_equal(solid.at(points), np.zeros(4), "a fog at first")
    np.testing.assert_array_equal(Solid(solid.half_box, jnp.asarray(0.5)).at(points), [0.5, 0.5, 0, 0])
    assert Solid.throughout().at(points) == 1.0
