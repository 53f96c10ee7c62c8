"""Reading a picture no finer than needed, and averaging it to the size that is wanted.

A JPEG can be decoded at a half, a quarter or an eighth of its size, which is faster: the decoder leaves out the finest waves of
each block of 8x8 sRGB values. The result is not quite the mean light of the pixels where neighbours differ much. Such a size is
used where a new pixel still covers `LEFT` x `LEFT` decoded ones, which are averaged as light.
"""

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.imaging import images
from koala3d.datasets.imaging.pixels import resize_light

LEFT = 4
"""A new pixel covers at least this many decoded ones along each axis, where a JPEG is decoded at a reduced size."""
READERS = min(os.cpu_count() or 1, 4)
"""Pictures to read at the same time; each takes the memory of a whole one."""
JPEG, END_OF_JPEG = b"\xff\xd8\xff", b"\xff\xd9"


def read_resized(image: Path, alpha: NDArray[Any] | None, width: int, height: int) -> NDArray[Any]:
    """(height, width, 3 or 4) sRGB of a picture of integers; `alpha` replaces its own. What is transparent is black.

    At the picture's own size these are the values of the files, as uint8 or uint16 where both hold the same type; else float32
    in 0..1, averaged over areas in linear light and weighted by alpha.

    Args:
        image: 8- or 16-bit file, 1 to 4 channels.
        alpha: (rows, columns, 1) of the picture's size, as `images.read_stored` has it; None for the picture's own.
        width: wanted width [px].
        height: wanted height [px].

    Raises:
        DatasetError: a file is damaged or too large.
    """
    resized = images.size(image) != (width, height)
    picture = in_colour(read_stored(image, width, height) if resized else images.read_stored(image))
    if resized:
        return _averaged(picture, alpha, width, height)
    if alpha is not None:
        same = picture.dtype == alpha.dtype
        parts = (picture[..., :3], alpha) if same else (images.as_float(picture[..., :3]), images.as_float(alpha))
        picture = np.concatenate(parts, axis=-1)
    return visible(picture)


def visible(picture: NDArray[Any]) -> NDArray[Any]:
    """The picture, black where its alpha is zero: what a mask hides may be anything, also nothing at all."""
    return picture if picture.shape[-1] == 3 else np.where(picture[..., 3:] == 0, picture.dtype.type(0), picture)


def read_stored(path: Path, width: int, height: int) -> NDArray[Any]:
    """`images.read_stored`, but of a JPEG as few pixels as are enough for an average to `width` x `height` [px].

    A file that does not end as a JPEG should is decoded whole, which finds out whether it is cut off.
    """
    spec = images.header(path)
    enough = [
        by
        for by in (8, 4, 2)
        if spec.width % by == spec.height % by == 0 and min(spec.width / width, spec.height / height) >= by * LEFT
    ]
    if not enough or spec.nchannels not in (1, 3) or not _is_whole_jpeg(path):
        return images.read_stored(path)
    import cv2

    kind = "COLOR" if spec.nchannels == 3 else "GRAYSCALE"
    flags = getattr(cv2, f"IMREAD_REDUCED_{kind}_{enough[0]}") | cv2.IMREAD_IGNORE_ORIENTATION
    pixels = cv2.imdecode(np.fromfile(path, np.uint8), flags)
    if pixels is None:
        return images.read_stored(path)
    pixels = cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB) if spec.nchannels == 3 else pixels[..., None]
    return np.ascontiguousarray(images.in_srgb(np.asarray(pixels), spec, path))


def averaged(stored: NDArray[Any], width: int, height: int) -> NDArray[np.float32]:
    """(height, width, channels) of what `images.read_stored` gives, scaled to 0..1 and averaged as it is: masks and alphas.

    Integers are averaged to integers, whose rounding is all that is lost.
    """
    shrinks = width <= stored.shape[1] and height <= stored.shape[0] and stored.shape[-1] <= 4
    if stored.dtype == np.float32 or not shrinks:
        return images.resize(images.as_float(stored), width, height, srgb=False)
    import cv2

    small = cv2.resize(stored, (width, height), interpolation=cv2.INTER_AREA)
    return images.as_float(np.asarray(small).reshape(height, width, -1))


def _is_whole_jpeg(path: Path) -> bool:
    with open(path, "rb") as file:
        start = file.read(len(JPEG))
        file.seek(-len(END_OF_JPEG), 2)
        return start == JPEG and file.read() == END_OF_JPEG


def in_colour(picture: NDArray[Any]) -> NDArray[Any]:
    """Grey as three equal channels; an alpha is kept."""
    if picture.shape[-1] >= 3:
        return picture
    return np.concatenate([picture[..., :1]] * 3 + [picture[..., 1:]], axis=-1)


def _averaged(picture: NDArray[Any], alpha: NDArray[Any] | None, width: int, height: int) -> NDArray[np.float32]:
    light = images.linear_from_stored(picture)
    if alpha is not None:
        cover = images.as_float(alpha)
        if cover.shape[:2] != light.shape[:2]:
            cover = images.resize(cover, light.shape[1], light.shape[0], srgb=False)
        light = np.concatenate([light[..., :3], cover], axis=-1)
    small = resize_light(light, width, height)
    small[..., :3] = images.srgb_from_linear(small[..., :3])
    return small
