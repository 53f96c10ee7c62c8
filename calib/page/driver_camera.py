"""What a camera's driver says of it in a ROS bag, beside what was calibrated."""

from typing import Any

import numpy as np

from koala3d.calib.intrinsics import crossval
from koala3d.datasets.bags.pictures import CameraInfo
from koala3d.datasets.camera_model import Camera

AGREES_PX = 2.0
"""A driver's camera that is further off than this somewhere is another one's, as far as a calibration can tell."""


def in_words(camera: Camera, camera_info: Any) -> str:
    """A sentence on how far the `camera_info` of a bag is from `camera`. Raises DatasetError where it is damaged."""
    if camera_info is None:
        return "the bag has no camera_info, so this camera could not be compared with the driver's"
    where = "bag, camera_info"
    driver = CameraInfo.from_json(camera_info, where=where).camera(camera.width, camera.height, where=where)
    if driver is None:
        return f"camera_info in the bag holds no calibration for pictures of {camera.width}x{camera.height}"
    off_px = crossval.difference(camera, driver).values_px
    if not np.isfinite(off_px).all():
        return "camera_info in the bag is of another lens"
    most, rms = float(off_px.max()), float(np.sqrt(np.mean(off_px**2)))
    advice = "; nodes that use it do not see what this camera sees: 'calib export --to ros'" if most > AGREES_PX else ""
    return f"camera_info in the bag is off from this camera by {rms:.2f} px rms, {most:.2f} px at most{advice}"
