"""How far the points of a scene are from where its pictures show them."""

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.scene import Scene


def errors_px(scene: Scene) -> NDArray[np.float64]:
    """(m,) distance of each sighting from its projected point [px]; infinite behind the camera, NaN for views that are missing.

    Raises:
        UsageError: the scene has no sightings.
    """
    if scene.points is None or scene.sightings is None:
        raise UsageError("scene does not say which views saw its points", where=scene.name)
    views = {view.name: view for view in scene.views}
    index = scene.sightings.index
    errors = np.full(len(index), np.nan)
    for number, name in enumerate(scene.sightings.names):
        rows = np.flatnonzero(index[:, 1] == number)
        if name not in views or not len(rows):
            continue
        view = views[name]
        local = (scene.points[index[rows, 0]] - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
        front = local[:, 2] > 0
        pixels = view.camera.project(np.where(front[:, None], local, [0.0, 0.0, 1.0]))
        distances = np.linalg.norm(pixels - scene.sightings.pixels[rows], axis=1)
        errors[rows] = np.where(front, distances, np.inf)
    return errors
