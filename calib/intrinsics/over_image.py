"""Values over the image of a camera, one for each cell of a grid."""

from dataclasses import dataclass

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.datasets.camera_model import Camera


@dataclass(frozen=True)
class Map:
    """A value for each cell of the image."""

    columns: Array  # (w,) middles of the cells [px]
    rows: Array  # (h,) [px]
    values_px: Array  # (h, w) [px]

    @property
    def rms_px(self) -> float:
        """Root mean square over the image [px]."""
        return float(np.sqrt(np.mean(self.values_px**2)))


def cells(camera: Camera, across: int, down: int) -> tuple[Array, Array, Array]:
    """(across,) columns, (down,) rows and (down * across, 2) pixels of the middles of cells over an image."""
    columns, rows = (np.arange(across) + 0.5) * camera.width / across, (np.arange(down) + 0.5) * camera.height / down
    return columns, rows, np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2)
