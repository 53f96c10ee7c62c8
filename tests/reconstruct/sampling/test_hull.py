from collections.abc import Callable

import equinox as eqx
import numpy as np

from koala3d.datasets.scene import Scene
from koala3d.reconstruct.sampling.hull import cells_in_masks
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
