"""Images on disk and in memory. The only module that imports OpenImageIO.

In memory an image is (height, width, channels). 8- and 16-bit files are scaled to 0..1; they are sRGB unless they state other
colours, which are converted (`imaging.profiles`). Alpha is straight. Float files (EXR, TIFF) are not scaled. Pixels are taken as
they are stored, whatever an orientation tag says (`imaging.orientation`).
"""

import errno
import os
import shutil
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets.core import files
from koala3d.datasets.core.budgets import budget, free_memory
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.imaging import layers, profiles
from koala3d.datasets.imaging.pixels import area_average, resize_light
from koala3d.datasets.imaging.srgb import linear_from_srgb, srgb_from_linear

PIXELS = "KOALA_MAX_PIXELS"
FREE_PIXELS, PIXELS_PER_BYTE = 2**25, 64
"""Budget of pixels of one image: the larger of these, the second for each byte of its file. Larger images are refused before
anything is decoded; the environment variable `PIXELS` replaces the budget."""
BYTES_PER_PIXEL = 32
"""Memory for one pixel of four channels: as floats, while it is decoded and afterwards."""
MOST_SHRUNK = 1200
"""Largest compression ratio of a valid file: deflate's 1032, and a margin for headers."""
MAGIC = (b"\x89PNG", b"\xff\xd8\xff", b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", b"\x76\x2f\x31\x01")
"""First bytes of the formats that are read: PNG, JPEG, TIFF, BigTIFF, EXR."""
OTHERS = (("WebP", 8, b"WEBP"), ("HEIC or AVIF", 4, b"ftyp"), ("BMP", 0, b"BM"), ("GIF", 0, b"GIF8"), ("JPEG XL", 4, b"JXL "))
"""Formats that are not read, whatever the suffix says: name, place and bytes of their mark."""
DESCRIPTIVE = frozenset(
    "Make Model Software DateTime Artist Copyright ImageDescription ExposureTime FNumber "
    "XResolution YResolution ResolutionUnit".split()
)
"""Header entries without a prefix that `metadata` keeps."""
_STEPS = {"uint8": 255, "uint16": 65535}
FLOAT_SUFFIXES = frozenset({".exr", ".tif", ".tiff"})
"""Formats that store floats; the others get 8 bits."""


def read(path: Path) -> NDArray[np.float32]:
    """(height, width, channels) float32 of an image file.

    Raises:
        UsageError: there is no such file.
        DatasetError: it is not an image, cut off, or larger than its budget of pixels or the free memory.
    """
    return _decoded(path, "float")


def read_stored(path: Path) -> NDArray[Any]:
    """(height, width, channels) as stored: uint8, uint16 or float32. Raises as `read` does."""
    return _decoded(path, None)


def _decoded(path: Path, kind: str | None) -> NDArray[Any]:
    """The image as an array of type `kind`; None for that of the file."""
    source = _open(path)
    spec = source.spec()
    stored = str(spec.format)
    try:
        pixels = source.read_image(kind or (stored if stored in _STEPS else "float"))
        complaint = source.geterror()
    except (MemoryError, UnicodeDecodeError) as error:  # UnicodeDecodeError: the message quotes damaged bytes
        pixels, complaint = None, type(error).__name__
    finally:
        source.close()
    if pixels is None or complaint:
        raise DatasetError("image cannot be read", where=path, why=complaint or "decoding failed", remedy="copy it again")
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    if (kept := layers.chosen(spec)) != list(range(spec.nchannels)):
        pixels = pixels[..., kept]
    if layers.has_associated_alpha(spec) and kept[-1] == spec.alpha_channel:
        pixels = layers.straight(pixels)
    return np.ascontiguousarray(layers.whole(in_srgb(pixels, spec, path), spec))


def in_srgb(pixels: NDArray[Any], spec: Any, path: Path) -> NDArray[Any]:
    """(height, width, channels) of a file in sRGB, if its ICC profile states other colours; DatasetError if it cannot be."""
    stored = spec.getattribute("ICCProfile") if pixels.shape[-1] in (3, 4) else None
    if stored is None:
        return pixels
    try:
        convert = profiles.conversion(bytes(np.asarray(stored, np.uint8)))
    except profiles.Unreadable as error:
        what, remedy = "colour profile of the image cannot be followed", "convert the image to sRGB"
        raise DatasetError(what, where=path, why=str(error), remedy=remedy) from None
    return pixels if convert is None else convert(pixels)


def size(path: Path) -> tuple[int, int]:
    """(width, height) of an image as `read` would return it, from the header alone. Raises as `read` does."""
    return layers.size(header(path))


def orientation(path: Path) -> int:
    """EXIF's number for how a viewer should turn an image: 1 for not at all, 2 to 8 else. Raises as `read` does."""
    return int(header(path).getattribute("Orientation") or 1)


def channels(path: Path) -> int:
    """Number of channels of an image, from the header alone; 2 and 4 include an alpha. Raises as `read` does."""
    return len(layers.chosen(header(path)))


def steps(path: Path) -> int:
    """The divisor of `read`, from the header alone: 255 or 65535 for integers, 1 for floats."""
    return _STEPS.get(str(header(path).format), 1)


def metadata(path: Path) -> dict[str, str | int | float]:
    """How an image was taken, from its header: camera, exposure, time, description.

    The orientation is left out: what is written says upright. Raises as `read` does.
    """
    found: dict[str, Any] = {}
    for entry in header(path).extra_attribs:
        try:
            found[entry.name] = entry.value
        except UnicodeDecodeError:  # text in another encoding, which nothing depends on
            continue
    kept = [name for name in found if name.startswith(("Exif:", "GPS:", "IPTC:")) or name in DESCRIPTIVE]
    return {name: found[name] for name in kept if isinstance(found[name], str | int | float) and name != "Orientation"}


def write(
    path: Path,
    array: ArrayLike,
    *,
    metadata: Mapping[str, str | int | float] | None = None,
    multiplied: bool = True,
) -> None:
    """Write (height, width) or (height, width, channels) atomically; the suffix selects the format.

    uint8 and uint16 are stored unchanged. Floats are stored as float32 in EXR and TIFF, float16 as half floats in EXR;
    elsewhere they are taken as 0..1 and rounded to 8 bits. Four channels are RGB and straight alpha. `metadata` is stored
    as far as the format allows. In an EXR the alpha multiplies the colours, unless `multiplied` is False since it means
    something else.

    Raises:
        DatasetError: the format cannot hold the array.
        OSError: the disk is full or not writable.
    """
    import OpenImageIO as oiio

    path = Path(path)
    pixels = np.asarray(array)
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    if pixels.ndim != 3 or 0 in pixels.shape:
        raise DatasetError("array is not an image", where=path, why=f"shape {np.shape(array)}")
    if pixels.dtype not in (np.uint8, np.uint16):
        as_float = path.suffix.lower() in FLOAT_SUFFIXES
        half = pixels.dtype == np.float16 and path.suffix.lower() == ".exr"
        pixels = pixels.astype(np.float16 if half else np.float32) if as_float else to_uint8(pixels)
    height, width, channels = pixels.shape
    kinds = {np.dtype(np.float32): "float", np.dtype(np.float16): "half"}
    spec = oiio.ImageSpec(width, height, channels, kinds.get(pixels.dtype, pixels.dtype.name))
    if multiplied and path.suffix.lower() == ".exr" and channels in (2, 4):  # its colours are multiplied by their alpha
        pixels = np.concatenate([pixels[..., :-1] * pixels[..., -1:], pixels[..., -1:]], axis=-1)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.attribute("png:compressionLevel", 4)  # a third of the time of 6 for 7 % more bytes
    spec.attribute("compression", "zip" if path.suffix.lower() in FLOAT_SUFFIXES else "jpeg:95")
    for name, value in (metadata or {}).items():
        spec.attribute(name, value)
    with files.atomic_path(path) as temporary:
        if oiio.ImageOutput.create(str(temporary)) is None:
            oiio.geterror()
            raise DatasetError("image format cannot be written", where=path, why=f"suffix {path.suffix!r}")
        target = oiio.ImageBuf(spec)
        target.set_pixels(oiio.ROI(), np.ascontiguousarray(pixels))
        good = target.write(str(temporary))  # in one call: libpng prints a message if Ctrl-C comes between opening and writing
        if shutil.disk_usage(path.parent).free < max(pixels.nbytes, 2**20):  # encoders do not report a failure of the last block
            good = good and _is_whole(temporary)
            if not good:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        if not good:
            raise DatasetError("image cannot be written", where=path, why=target.geterror())


def to_uint8(array: ArrayLike) -> NDArray[np.uint8]:
    """0..1 clipped and rounded to 0..255. Raises DatasetError where a value is NaN."""
    return (_within(np.asarray(array, np.float32)) * 255 + 0.5).astype(np.uint8)


def to_uint16(array: ArrayLike) -> NDArray[np.uint16]:
    """0..1 clipped and rounded to 0..65535. Raises DatasetError where a value is NaN."""
    return (_within(np.asarray(array, np.float64)) * 65535 + 0.5).astype(np.uint16)


def _within(array: NDArray[Any]) -> NDArray[Any]:
    if np.isnan(array).any():
        raise DatasetError("picture holds NaN", why=f"{int(np.isnan(array).sum())} of {array.size} values")
    return np.clip(array, 0, 1)


def as_float(stored: NDArray[Any]) -> NDArray[np.float32]:
    """What `read` gives, from what `read_stored` gives: integers scaled to 0..1, floats as they are."""
    if stored.dtype == np.float32:
        return stored
    return stored.astype(np.float32) * np.float32(1 / np.iinfo(stored.dtype).max)


@cache
def _light_of_steps(kind: type) -> NDArray[np.float32]:
    """Linear light of every value that an integer type can hold."""
    return linear_from_srgb(as_float(np.arange(np.iinfo(kind).max + 1, dtype=kind)))


def linear_from_stored(stored: NDArray[Any]) -> NDArray[np.float32]:
    """Linear light of the result of `read_stored`; alpha, the second or fourth channel, is only scaled to 0..1."""
    if stored.dtype == np.float32:
        return stored.astype(np.float32)
    table = _light_of_steps(stored.dtype.type)
    if stored.dtype == np.uint8:
        import cv2

        light = np.asarray(cv2.LUT(stored, table[None]), np.float32).reshape(stored.shape)
    else:
        light = table[stored]
    if stored.shape[-1] in (2, 4):
        light[..., -1] = as_float(stored[..., -1])
    return light


def resize(array: ArrayLike, width: int, height: int, *, srgb: bool = True) -> NDArray[np.float32]:
    """Area average to (height, width, channels), for any factor: each new pixel is the mean light of the area it covers.

    Colours are averaged as linear light weighted by alpha, then converted back. With `srgb=False` the values are averaged
    unchanged (masks, depth, linear light without alpha).
    Channels: 1 or 3 colour, 2 or 4 colour and straight alpha.
    """
    pixels = np.asarray(array, np.float32)
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    if pixels.shape[:2] == (height, width):
        return pixels.copy()
    if not srgb:
        return area_average(pixels, width, height)
    if pixels.shape[-1] in (2, 4):
        light = np.concatenate([linear_from_srgb(pixels[..., :-1]), pixels[..., -1:]], axis=-1)
        small = resize_light(light, width, height)
        return np.concatenate([srgb_from_linear(small[..., :-1]), small[..., -1:]], axis=-1)
    return srgb_from_linear(area_average(linear_from_srgb(pixels), width, height))


def _open(path: Path) -> Any:
    """An open OpenImageIO input, its header checked."""
    import OpenImageIO as oiio

    path = Path(path)
    if not path.is_file():
        raise UsageError("no such image", where=path, remedy="check the path")
    try:
        str(path).encode()
    except UnicodeEncodeError:
        name = str(path).encode(errors="backslashreplace").decode()
        raise DatasetError("name of the image is not UTF-8", where=name, remedy="rename it") from None
    with open(path, "rb") as file:
        if not (head := file.read(12)).startswith(MAGIC):  # the library would try dozens of other formats; some run programs
            raise _foreign(path, head)
    wanted = oiio.ImageSpec()
    wanted.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(str(path), wanted)
    if source is None:
        try:
            why = oiio.geterror() or "no header"
        except UnicodeDecodeError:
            why = "its header is damaged"
        raise DatasetError("image cannot be read", where=path, why=why, remedy="copy it again")
    spec = source.spec()
    complaint = _beyond(spec, path)
    if complaint is not None:
        source.close()
        raise complaint
    return source


def _foreign(path: Path, head: bytes) -> DatasetError:
    """The error of a file that begins with other bytes than those of the formats that are read."""
    if not head:
        return DatasetError("image cannot be read", where=path, why="the file is empty", remedy="copy it again")
    name = next((name for name, at, mark in OTHERS if head[at : at + len(mark)] == mark), None)
    if name is None:
        return DatasetError("image cannot be read", where=path, why="it is not a PNG, JPEG, TIFF or EXR", remedy="copy it again")
    return DatasetError("image cannot be read", where=path, why=f"it is a {name}", remedy="convert it to PNG or JPEG")


def _beyond(spec: Any, path: Path) -> DatasetError | None:
    """What is wrong with the size that a header states; None where it is within the budget."""
    width, height = (max(pair) for pair in zip(layers.size(spec), (spec.width, spec.height), strict=True))
    size, stored = f"its header says {width}x{height}x{spec.nchannels}", path.stat().st_size
    pixels = width * height * max(spec.nchannels, 4) / 4
    allowed = budget(PIXELS, max(FREE_PIXELS, PIXELS_PER_BYTE * stored))
    remedy = f"if you trust the file, set {PIXELS} to a larger number"
    if not 0 < pixels <= allowed or spec.nchannels > 64 or spec.depth > 1:
        why = f"{size}; the budget for a file of {stored} bytes is {allowed} pixels of four channels"
        return DatasetError("image is too large", where=path, why=why, remedy=remedy)
    if spec.image_bytes() > MOST_SHRUNK * stored + 2**16:
        return DatasetError(
            "image cannot be read", where=path, why=f"{size}, too much for {stored} bytes", remedy="copy it again"
        )
    needed = int(pixels * BYTES_PER_PIXEL)
    if pixels > FREE_PIXELS and needed > free_memory():
        why = f"{size}, which takes {needed >> 20} MiB; {free_memory() >> 20} MiB are free"
        return DatasetError("image does not fit into the memory", where=path, why=why, remedy="close other programs")
    return None


def header(path: Path) -> Any:
    """OpenImageIO's specification of a file."""
    source = _open(path)
    spec = source.spec()
    source.close()
    return spec


def _is_whole(path: Path) -> bool:
    try:
        read(path)
    except DatasetError:
        return False
    return True
