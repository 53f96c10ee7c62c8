"""The white balance of a grey card in the live picture, stored for recordings that use it unchanged."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from koala3d.capture.drivers.protocols import Camera
from koala3d.capture.sessions.live.analysis import Part
from koala3d.capture.sessions.live.flat import values_of
from koala3d.datasets.imaging.region import Region
from koala3d.datasets.radiometry.measure import rebalanced
from koala3d.datasets.radiometry.mosaic import pattern_of
from koala3d.datasets.radiometry.response import Response

PICTURES = 8
"""Pictures that are averaged."""


def known_response(camera: Camera, stored: str, height: int, width: int, channels: int) -> Response:
    """The response in a file of `capture flat`, or without one that of a perfect sensor, named after the camera.

    Raises UsageError: the file is that of another camera.
    """
    measured, said = stored_response(camera, stored), camera.description()
    if measured is not None:
        return measured
    name = said["pixel_format"]
    mosaic = pattern_of(name) and name.endswith("12")
    perfect = Response.unmeasured(height, width, (2, 2, 1) if mosaic else (1, 1, channels))
    region = Region.from_json(said["region"], where="camera")
    about = {"serial": said["serial"], "pixel_format": name, "gain_db": float(said["gain_db"])}
    return replace(perfect, region=region, **about).of_camera(said, where="camera")


def stored_response(camera: Camera, stored: str) -> Response | None:
    """The response in a file of `capture flat`; None without a file. Raises UsageError: it is another camera's."""
    if not stored:
        return None
    return Response.load(Path(stored)).of_camera(camera.description(), where=stored)


def white_balance(camera: Camera, part: Part, stored: str = "") -> Response:
    """The response of a camera with the white balance of the card that `part` of its pictures shows.

    Args:
        stored: file of `capture flat`, whose black level and flat field are kept; empty: none.

    Raises UsageError: the card is too dark or too bright, or the file is that of another camera.
    """
    pictures = [values_of(camera.grab()) for _ in range(PICTURES)]
    mean = np.mean(pictures, axis=0, dtype=np.float32)
    raw = str(camera.description()["pixel_format"]).endswith("12")
    known = known_response(camera, stored, *mean.shape)
    return rebalanced(known, mean, slice(part.top, part.bottom), slice(part.left, part.right), raw=raw)


def words(found: Response) -> str:
    """The balance for a person."""
    return f"balance    {', '.join(f'{value:.3f}' for value in found.balance.ravel())} make the region grey"
