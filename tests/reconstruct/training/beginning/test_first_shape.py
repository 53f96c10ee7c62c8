from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.datasets.scene import Scene, View
from koala3d.reconstruct.field.outline import CELL, GRID
from koala3d.reconstruct.sampling.hull import cells_in_masks
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from koala3d.reconstruct.scene.reading import training_pixels
from koala3d.reconstruct.training.beginning import first_shape
from tests.reconstruct import glossy_ball

CELLS = 96


@pytest.fixture(scope="module")
def blank(glossy_scene: tuple[Scene, Path]) -> tuple[tuple[View, ...], Pixels, Normalisation]:
    """Training views of a painted ball with a highlight, their pixels, and how they are normalised."""
    scene = glossy_scene[0]
    views, normalisation = scene.split("train"), Normalisation.of(scene)
    return views, training_pixels(views, normalisation, 1.0, None)[0], normalisation


@pytest.fixture(scope="module")
def possible(blank: tuple[tuple[View, ...], Pixels, Normalisation]) -> np.ndarray:
    """Cells that its masks leave."""
    views, pixels, normalisation = blank
    cells = cells_in_masks(pixels, views, normalisation, CELLS, 1.0)
    assert cells is not None
    return cells


def ball(radius: float, cells: int = CELLS) -> np.ndarray:
    """Cells of the cube that a ball about its middle meets."""
    axis = (np.arange(cells) + 0.5) * 2 / cells - 1
    return (np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij")), axis=0) < radius).reshape(-1)


def radii() -> np.ndarray:
    """Distance of the grid's points from the middle."""
    axis = (np.arange(GRID) + 0.5) * CELL - 1
    return np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij")), axis=0)


def test_the_distance_is_that_to_the_cells_border() -> None:
    distance = first_shape.signed_distance(ball(0.6))
    error = distance - (radii() - 0.6)
    near = np.abs(distance) < 0.1
    # cells of 0.02 are all in or all out, and a distance to their middles is half a cell off; smoothing rounds the rest
    assert np.abs(error[near]).max() < 0.02 and abs(error[near].mean()) < 0.01


def test_the_cube_s_faces_are_a_border_too() -> None:
    distance = first_shape.signed_distance(np.ones(CELLS**3, bool))
    assert distance[GRID // 2, GRID // 2, GRID // 2] < -0.5 and np.abs(distance[0, GRID // 2, GRID // 2]) < 0.05


def test_places_lie_on_the_border_with_outward_normals() -> None:
    places, points, normals = first_shape.surface_of(first_shape.signed_distance(ball(0.6)))
    radius = np.linalg.norm(points, axis=-1)
    assert len(places) > 1000 and np.abs(radius - 0.6).max() < 0.02
    assert np.sum(points / radius[:, None] * normals, -1).min() > np.cos(np.deg2rad(12))  # steps of cells, smoothed


def test_paint_is_found_under_a_highlight(blank: tuple[tuple[View, ...], Pixels, Normalisation], possible: np.ndarray) -> None:
    hull = first_shape.measured(possible, *blank, 1.0)
    assert hull is not None
    places, _, normals = first_shape.surface_of(hull.distance)
    error = hull.common[tuple(places.T)] - glossy_ball.paint(normals)
    # the quantile is below the mean where pixels straddle waves of paint, and cells smooth them
    assert np.abs(np.median(error)) < 0.06 and np.quantile(np.abs(error), 0.9) < 0.15


def test_a_mirror_is_dark_if_some_views_are(blank: tuple[tuple[View, ...], Pixels, Normalisation], possible: np.ndarray) -> None:
    """Every other view sees something dark in it, the rest a lamp."""
    views, pixels, normalisation = blank
    shown = np.where(np.asarray(pixels.view)[:, None] % 2 == 0, 0.1, 0.9).astype(np.float16)
    colour = jnp.concatenate([jnp.broadcast_to(shown, (len(shown), 3)), pixels.colour[:, 3:]], -1)
    hull = first_shape.measured(possible, views, replace(pixels, colour=colour), normalisation, 1.0)
    assert hull is not None
    places, _, _ = first_shape.surface_of(hull.distance)
    assert np.quantile(hull.common[tuple(places.T)], 0.9) < 0.1  # 0.1 is 0.01 of linear light; few places are in few views


def test_what_another_part_hides_is_not_asked() -> None:
    """A small ball before a large one: from there, the middle of the large one is not seen, and its rim is."""
    axis = (np.arange(GRID) + 0.5) * CELL - 1
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    large, small = (np.linalg.norm(grid - [x, 0, 0], axis=-1) - radius for x, radius in ((-0.5, 0.4), (0.5, 0.2)))
    points = np.array([[-0.1, 0, 0], [-0.5, 0.4, 0]])
    hidden = first_shape._hidden(np.minimum(large, small), points, np.array([[1.0, 0, 0], [1.0, 0, 0]]))
    assert hidden.tolist() == [True, False]


def test_masks_that_leave_nothing_have_no_hull(blank: tuple[tuple[View, ...], Pixels, Normalisation]) -> None:
    assert first_shape.measured(np.zeros(CELLS**3, bool), *blank, 1.0) is None
