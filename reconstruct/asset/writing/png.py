"""Textures as PNG files in memory."""

import numpy as np
from jaxtyping import UInt8


def encoded(picture: UInt8[np.ndarray, "height width 3"]) -> bytes:
    """The bytes of a PNG file."""
    import cv2

    good, data = cv2.imencode(".png", picture[..., ::-1])  # OpenCV has blue first
    assert good, "OpenCV writes any picture of 8 bits"
    return data.tobytes()
