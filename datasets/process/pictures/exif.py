"""What the header of a photograph says about its lens."""

from collections.abc import Mapping

import numpy as np

Header = Mapping[str, str | int | float]

FILM_DIAGONAL_MM = float(np.hypot(36, 24))
"""Diagonal of 35 mm film, to which "35 mm equivalent" focal lengths refer (CIPA DCG-001)."""
UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0}
"""Millimetres in the unit of the focal plane's resolution, by its EXIF number."""


def focal_length(header: Header, width: int, height: int) -> float | None:
    """Focal length [px] of a photograph of `width` x `height` pixels, from `images.metadata`; None where it is not stated.

    The equivalent on film comes first, since it stays right when pictures are made smaller.
    """
    on_film = _number(header, "Exif:FocalLengthIn35mmFilm")
    if on_film > 0:
        return on_film * float(np.hypot(width, height)) / FILM_DIAGONAL_MM
    focal_mm, density = _number(header, "Exif:FocalLength"), _number(header, "Exif:FocalPlaneXResolution")
    unit = UNIT_MM.get(int(_number(header, "Exif:FocalPlaneResolutionUnit", 2)))
    if unit is None or focal_mm <= 0 or density <= 0:
        return None
    full = _number(header, "Exif:PixelXDimension", max(width, height))  # of the picture as it was taken
    return focal_mm * density / unit * max(width, height) / full if full > 0 else None


def lens(header: Header) -> tuple[str, ...]:
    """What photographs of one camera with one lens at one focal length have in common; empty words where it is not stated."""
    keys = ("Make", "Model", "Exif:LensModel", "Exif:FocalLength", "Exif:FocalLengthIn35mmFilm", "Exif:DigitalZoomRatio")
    return tuple(str(header.get(key, "")).strip() for key in keys)


def _number(header: Header, key: str, otherwise: float = 0.0) -> float:
    """A positive finite number of the header; `otherwise` where there is none."""
    try:
        value = float(header.get(key, otherwise))
    except ValueError:
        return otherwise
    return value if np.isfinite(value) and value > 0 else otherwise
