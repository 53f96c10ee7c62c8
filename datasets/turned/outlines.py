"""What masks show of an object's convex hull: the rays that a string around each mask would follow."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from skimage.measure import find_contours

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.splits import evenly

SIDE = 1000
"""Longest side at which masks are read [px]: outlines between pixels are then known to a tenth of one."""
VIEWS = 48
"""Views of a session that are read at most: every pair of views of both sessions is compared."""
SPECK = 0.02
"""Parts of a mask with a smaller share of the largest part's area are no part of the object."""
SMALLEST = 100.0
"""Area of a mask that shows anything of a shape [px^2]."""
LOW = 0.3
"""Share of the object's height below which an outline is low: near what it stands on, masks are of its shadow as well."""
FEWEST = 6
"""Views that show all of the object, at least: fewer leave the motion to single masks."""
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Outlines:
    """Of n views of one session, in its world."""

    centres: Array
    """(n, 3) of the cameras."""
    rays: Array
    """(n, k, 3) unit directions to the corners of the outlines' convex hulls; shorter lists repeat their first."""
    low: NDArray[np.bool_]
    """(n, k) whether a ray passes the object's middle near what the object stands on."""
    pixel: float
    """Width of a pixel of the masks, as they were read, at the object [world unit]; the median."""
    middle: Array
    """(3,) the point nearest to the middles of all outlines."""
    extent: float
    """Mean radius of the outlines at the object [world unit]."""

    @property
    def pixel_angle(self) -> float:
        """Of a pixel, as the object's middle is seen [rad]."""
        return self.pixel / float(np.median(np.linalg.norm(self.centres - self.middle, axis=-1)))

    def some(self, views: int, corners: int) -> "Outlines":
        """Of so many views, spread evenly, with so many corners each, at most."""
        chosen = np.unique(np.linspace(0, len(self.centres) - 1, views).round().astype(int))
        kept = np.unique(np.linspace(0, self.rays.shape[1] - 1, corners).round().astype(int))
        rays, low = self.rays[chosen][:, kept], self.low[chosen][:, kept]
        return Outlines(self.centres[chosen], rays, low, self.pixel, self.middle, self.extent)


def outlines_of(scene: Scene) -> Outlines:
    """The outlines in a scene's masks.

    Raises UsageError: the scene has no masks, or too few of them show the whole object.
    """
    if scene.background != "white" or any(
        view.mask is None and images.channels(view.image) not in (2, 4) for view in scene.views
    ):
        raise UsageError("scene has no masks of the object", where=scene.name, remedy="make them: 'datasets mask'")
    centres, corners, pixels = [], [], []
    for view in evenly(list(scene.views), VIEWS):
        found = _corners(view)
        if found is not None:
            centres.append(view.world_from_camera[:3, 3])
            corners.append(found)
            small = view.camera.within(SIDE)
            pixels.append(2 / (small.fx + small.fy))
    if len(centres) < FEWEST:
        why = f"{len(centres)} of {len(scene.views)} masks have room around the object"
        remedy = f"at least {FEWEST} must; a mask that touches the picture's edge hides where the object ends"
        raise UsageError("too few masks show the whole object", where=scene.name, why=why, remedy=remedy)
    most = max(map(len, corners))
    rays = np.stack([np.concatenate([one, np.repeat(one[:1], most - len(one), 0)]) for one in corners])
    places, towards = np.stack(centres), np.stack([one.mean(0) for one in corners])
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    across = np.eye(3) - towards[:, :, None] * towards[:, None]
    middle = np.linalg.solve(across.sum(0), np.einsum("nij,nj->i", across, places))
    away = np.linalg.norm(middle - places, axis=-1)
    radii = away * np.array([np.arccos(np.clip(one @ t, -1, 1)).mean() for one, t in zip(corners, towards, strict=True)])
    low = _heights(scene.box, places, rays, middle) < LOW
    return Outlines(places, rays, low, float(np.median(away * pixels)), middle, float(radii.mean()))


def _heights(box: Array, centres: Array, rays: Array, middle: Array) -> Array:
    """(n, k) how high rays pass the object's middle above the face of its box away from the cameras, in heights of the object."""
    above = centres.mean(0) - middle
    axis = int(np.abs(above).argmax())
    along = np.sum((middle - centres)[:, None] * rays, -1)
    passing = centres[:, None, axis] + along * rays[..., axis]
    heights = passing - box[0, axis] if above[axis] > 0 else box[1, axis] - passing
    return heights / max(float(np.percentile(heights, 99)), 1e-12)


def _corners(view: View) -> Array | None:
    """(k, 3) unit directions in the world to the corners of the convex hull of a view's mask; None where the mask is cut off."""
    camera = view.camera.within(SIDE)
    cover = view.read_cover(camera.width, camera.height)
    if max(edge.max() for edge in (cover[0], cover[-1], cover[:, 0], cover[:, -1])) > 0.5:
        return None
    contours = find_contours(cover, 0.5)
    areas = [abs(_area(contour)) for contour in contours]
    if max(areas, default=0.0) < SMALLEST:
        return None
    kept = [contour for contour, area in zip(contours, areas, strict=True) if area >= SPECK * max(areas)]
    pixels = np.concatenate(kept)[:, ::-1] + 0.5  # of rows and columns, of which the first centre is at zero
    directions = camera.directions(pixels)
    try:
        corners = directions[ConvexHull(directions[:, :2]).vertices]
    except QhullError:
        return None
    return corners / np.linalg.norm(corners, axis=-1, keepdims=True) @ view.world_from_camera[:3, :3].T


def _area(contour: Array) -> float:
    """Of a closed polygon, in pixels; signed."""
    x, y = contour.T
    return float(x @ np.roll(y, 1) - y @ np.roll(x, 1)) / 2
