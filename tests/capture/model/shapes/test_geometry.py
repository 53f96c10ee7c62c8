"""Boxes and poses as a person writes them."""

import numpy as np
import pytest
from pydantic import ValidationError

from koala3d.capture.model.shapes.geometry import Box, PoseDescription


def test_corners_are_half_the_size_from_the_centre() -> None:
    corners = Box(centre=(0.4, 0.0, 0.15), size=(0.2, 0.3, 0.1)).corners
    np.testing.assert_allclose(corners, [[0.3, -0.15, 0.1], [0.5, 0.15, 0.2]])


@pytest.mark.parametrize("size", [(0.2, 0.0, 0.1), (0.2, 0.3, -0.1)])
def test_a_box_without_volume_is_refused(size: tuple[float, float, float]) -> None:
    with pytest.raises(ValidationError, match="size must be positive along every axis"):
        Box(centre=(0, 0, 0), size=size)


def test_an_infinite_box_is_refused() -> None:
    with pytest.raises(ValidationError, match="finite"):
        Box(centre=(0, 0, 0), size=(1, 1, float("inf")))


def test_a_rotation_vector_is_axis_times_degrees() -> None:
    matrix = PoseDescription(position=(0.1, 0.2, 0.3), rotation_deg=(0, 0, 90)).matrix()
    np.testing.assert_allclose(matrix @ [1, 0, 0, 1], [0.1, 1.2, 0.3, 1], atol=1e-12)
    np.testing.assert_array_equal(PoseDescription().matrix(), np.eye(4))
