from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from koala3d.datasets.scene import Scene
from koala3d.reconstruct.field.outline import CELL, GRID
from koala3d.reconstruct.sampling.hull import cells_in_masks
from koala3d.reconstruct.sampling.hull_distance import hull_distance
from koala3d.reconstruct.sampling.occupancy import cell_centres
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from koala3d.reconstruct.scene.reading import training_pixels
from tests.reconstruct.glossy_ball import RADIUS

CELLS = 64


@pytest.fixture(scope="module")
def masked(glossy_scene: tuple[Scene, Path]) -> tuple[Pixels, np.ndarray, Normalisation]:
    """Pixels of a ball, the cells that its masks leave, and how the scene is normalised."""
    scene = glossy_scene[0]
    views, normalisation = scene.split("train"), Normalisation.of(scene)
    pixels, _ = training_pixels(views, normalisation, 1.0, None)
    cells = cells_in_masks(pixels, views, normalisation, CELLS, 1.0)
    assert cells is not None
    return pixels, cells, normalisation


def at_surface(distance: np.ndarray, normalisation: Normalisation) -> np.ndarray:
    """The distance at points of the ball."""
    directions = np.random.default_rng(0).normal(size=(500, 3))
    world = RADIUS * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    places = (((world - normalisation.centre) * normalisation.scale + 1) / CELL - 0.5).T
    return np.asarray(ndimage.map_coordinates(distance, places, order=1))


def test_it_is_zero_where_the_masks_show_that_the_object_ends(masked: tuple[Pixels, np.ndarray, Normalisation]) -> None:
    pixels, cells, normalisation = masked
    found = hull_distance(cells, pixels)
    assert found is not None and found.shape == (GRID,) * 3
    cell, distances = 2 / CELLS, at_surface(found, normalisation)
    assert abs(np.median(distances)) < cell / 3  # and the cells alone reach beyond it by
    blank = replace(pixels, colour=jnp.zeros_like(pixels.colour))
    reaching = hull_distance(cells, blank)  # nothing to fit them to
    assert reaching is not None and np.median(at_surface(reaching, normalisation)) < -cell


def test_masks_that_leave_nothing_have_no_hull(masked: tuple[Pixels, np.ndarray, Normalisation]) -> None:
    assert hull_distance(np.zeros_like(masked[1]), masked[0]) is None


def test_what_lies_beyond_the_cube_is_outside(masked: tuple[Pixels, np.ndarray, Normalisation]) -> None:
    """Cells that are possible right up to the cube's faces are cut there."""
    blank = replace(masked[0], colour=jnp.zeros_like(masked[0].colour))
    found = hull_distance(np.ones(CELLS**3, bool), blank)
    assert found is not None
    height = np.abs(cell_centres(GRID, 1.0)).max(-1).reshape(found.shape)
    assert found[height < 0.5].max() < -0.3 and np.abs(found[height > 1 - CELL]).max() < 3 * 2 / CELLS
