from collections.abc import Callable
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from koala3d.datasets.scene import Scene
from koala3d.reconstruct.sampling.hull import cells_in_masks, pixels_on_cells
from koala3d.reconstruct.sampling.occupancy import cell_centres
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from tests import drawn


class Silent:
    """A progress that nobody looks at."""

    def advance(self) -> None:
        pass


def pixels_of(scene: Scene) -> Pixels:
    return Pixels.load(scene.views, Normalisation.of(scene), 1.0, Silent())


def test_masks_leave_what_they_all_show(make_scene: Callable[..., Scene]) -> None:
    """Discs of 20 pixels at 0.4 m with f = 90 px: a ball of about 0.09 m about the axis stays, the box's corners go."""
    scene = make_scene(mask=True)
    normalisation = Normalisation.of(scene)
    cells = cells_in_masks(pixels_of(scene), scene.views, normalisation, 16, 1.0)
    world = cell_centres(16, 1.0) / normalisation.scale + normalisation.centre
    distance = np.linalg.norm(world, axis=-1)
    assert cells is not None
    assert cells[distance < 0.06].all(), "nothing that every mask shows may be ruled out"
    assert not cells[distance > 0.15].any()
    assert 0.05 < cells.mean() < 0.9


def test_one_wrong_mask_rules_nothing_out(make_scene: Callable[..., Scene]) -> None:
    scene = make_scene(mask=True)
    normalisation, pixels = Normalisation.of(scene), pixels_of(scene)
    colour = np.where((np.asarray(pixels.view) == 2)[:, None], 0, pixels.colour)
    spoilt = eqx.tree_at(lambda p: p.colour, pixels, drawn.array(colour, np.float16))
    world = cell_centres(16, 1.0) / normalisation.scale + normalisation.centre
    cells = cells_in_masks(spoilt, scene.views, normalisation, 16, 1.0)
    assert cells is not None and cells[np.linalg.norm(world, axis=-1) < 0.06].all() and not cells.all()


def test_views_without_masks_rule_nothing_out(make_scene: Callable[..., Scene]) -> None:
    scene = make_scene(mask=False)
    assert cells_in_masks(pixels_of(scene), scene.views, Normalisation.of(scene), 8, 1.0) is None


def test_pixels_whose_rays_meet_a_possible_cell_are_kept(make_scene: Callable[..., Scene]) -> None:
    """Rays are walked through a grid with a bar in it; 21 cells per axis are no whole number of blocks."""
    scene = make_scene(mask=True)
    normalisation, cells = Normalisation.of(scene), 21
    pixels, centres = pixels_of(scene), cell_centres(cells, 1.0)
    possible = (np.abs(centres[:, :2] - 0.3) < 0.1).all(-1)
    kept = pixels_on_cells(possible, scene.views, normalisation, 1.0)
    t = np.linspace(normalisation.near, 8, 2000)
    index = np.random.default_rng(0).choice(len(kept), 3000, replace=False)
    rays, _ = pixels.take(jnp.asarray(index))
    meets = np.zeros(len(index), bool)
    for ray, (origin, direction) in enumerate(zip(np.asarray(rays.origins), np.asarray(rays.directions), strict=True)):
        points = origin + t[:, None] * direction
        inside = points[(np.abs(points) < 1).all(-1)]
        cell = ((inside + 1) / 2 * cells).astype(int)
        meets[ray] = possible[(cell[:, 0] * cells + cell[:, 1]) * cells + cell[:, 2]].any()
    assert meets.any() and not (meets & ~kept[index]).any()
    assert kept.mean() < 0.8


def test_a_view_from_among_the_cells_keeps_its_pixels(make_scene: Callable[..., Scene]) -> None:
    scene = make_scene(mask=True)
    camera = scene.views[0].world_from_camera[:3, 3]
    around = replace(Normalisation.of(scene), centre=tuple(camera.tolist()))
    kept = pixels_on_cells(np.ones(8**3, bool), scene.views, around, 1.0)
    size = scene.views[0].camera.width * scene.views[0].camera.height
    assert kept[:size].all()
