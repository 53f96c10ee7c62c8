from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.imaging import images, reduced
from koala3d.datasets.scene import View
from tests.foreign import photographs

RANDOM = np.random.default_rng(0)
WIDTH, HEIGHT = 96, 64


def viewed(image: Path, mask: Path | None = None, width: int = WIDTH, height: int = HEIGHT) -> View:
    """A view of one picture; its pose does not matter."""
    return View("a", Camera(width, height, 90.0, 90.0, width / 2, height / 2), np.eye(4), "train", image, mask)


def plainly(view: View, width: int, height: int) -> NDArray[np.float32]:
    """The reference: all of the picture as floats, what is transparent black, resized where sizes differ."""
    picture = view.read()
    if picture.shape[-1] == 4:
        picture = np.where(picture[..., 3:] == 0, np.float32(0), picture)
    return picture if picture.shape[:2] == (height, width) else images.resize(picture, width, height)


def smooth(height: int, width: int) -> NDArray[np.float32]:
    """A picture without detail of a pixel's width, three channels in 0..1."""
    columns, rows = np.meshgrid(np.linspace(0, 6, width), np.linspace(0, 4, height))
    return (0.5 + 0.45 * np.sin(columns[..., None] + [0, 1, 2]) * np.cos(rows[..., None])).astype(np.float32)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("size", [(WIDTH, HEIGHT), (48, 32), (37, 25), (120, 80)])
@pytest.mark.parametrize("mask", [False, True])
def test_integers_give_the_same_bits_as_floats(
    tmp_path: Path, channels: int, kind: Any, size: tuple[int, int], mask: bool
) -> None:
    stored = RANDOM.integers(0, np.iinfo(kind).max, (HEIGHT, WIDTH, channels), kind, endpoint=True)
    if channels in (2, 4):
        stored[:20, ..., -1] = 0
    images.write(tmp_path / "a.png", stored)
    images.write(tmp_path / "m.png", RANDOM.choice(np.array([0, 255, 90], np.uint8), (HEIGHT, WIDTH)))
    view = viewed(tmp_path / "a.png", tmp_path / "m.png" if mask else None)
    found = view.read_resized(*size)
    assert found.dtype == (np.float32 if size != (WIDTH, HEIGHT) or (mask and kind == np.uint16) else kind)
    np.testing.assert_array_equal(images.as_float(found), plainly(view, *size))


@pytest.mark.parametrize("size", [(WIDTH, HEIGHT), (24, 16)])
@pytest.mark.parametrize("variant", ["inverted", "labels", "alpha", "other size", "jpeg", "16 bits"])
def test_every_variant_of_masks_is_read_as_a_mask(tmp_path: Path, variant: str, size: tuple[int, int]) -> None:
    disc = np.hypot(*(np.indices((HEIGHT, WIDTH)) - [[[30]], [[50]]])) < 20
    mask = np.uint8(disc * 255)
    mask[30, 50] = 77
    stored = {
        "labels": np.uint8(disc),
        "alpha": np.stack([np.full_like(mask, 255)] * 3 + [mask], -1),
        "other size": mask[::2, ::2],
        "16 bits": mask.astype(np.uint16) * 257,
    }.get(variant, mask)
    path = tmp_path / ("m.jpg" if variant == "jpeg" else "m.png")
    images.write(path, stored)
    images.write(tmp_path / "a.png", RANDOM.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8))
    view = replace(viewed(tmp_path / "a.png", path), mask_inverted=variant == "inverted")
    found = images.as_float(view.read_resized(*size))
    np.testing.assert_array_equal(found, plainly(view, *size))
    inside = found[size[1] * 31 // HEIGHT, size[0] * 53 // WIDTH, 3]
    assert (inside == 0) if variant == "inverted" else (inside > 0.9), "the premise: the object is in the middle"


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_every_step_has_the_light_of_its_float(tmp_path: Path, kind: Any) -> None:
    steps = np.arange(np.iinfo(kind).max + 1, dtype=kind).reshape(-1, 256, 1)
    images.write(tmp_path / "a.png", steps)
    expected = images.read(tmp_path / "a.png")
    np.testing.assert_array_equal(images.as_float(steps), expected)
    np.testing.assert_array_equal(images.linear_from_stored(steps), images.linear_from_srgb(expected))


def test_floats_are_read_as_before(tmp_path: Path) -> None:
    images.write(tmp_path / "a.exr", RANDOM.random((HEIGHT, WIDTH, 4), np.float32) * [2, 2, 2, 1])
    view = viewed(tmp_path / "a.exr")
    for size in ((WIDTH, HEIGHT), (24, 16)):
        np.testing.assert_array_equal(view.read_resized(*size), plainly(view, *size))
    images.write(tmp_path / "a.exr", np.full((HEIGHT, WIDTH, 3), np.nan, np.float32))
    with pytest.raises(DatasetError, match="not finite"):
        view.read_resized(24, 16)


def jpeg(path: Path, picture: NDArray[np.float32]) -> Path:
    """A JPEG of the highest quality."""
    cv2.imwrite(str(path), images.to_uint8(picture)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])
    return path


@pytest.mark.parametrize(("size", "decoded"), [((100, 75), 1), ((80, 60), 2), ((40, 30), 4), ((20, 15), 8), ((7, 5), 8)])
def test_a_jpeg_is_decoded_no_finer_than_needed(tmp_path: Path, size: tuple[int, int], decoded: int) -> None:
    path = jpeg(tmp_path / "a.jpg", smooth(480, 640))
    found = reduced.read_stored(path, *size)
    assert found.shape == (480 // decoded, 640 // decoded, 3)
    view = viewed(path, width=640, height=480)
    # a smooth picture loses nothing but rounding: half a step for each decoding, and half for the chroma
    assert np.abs(view.read_resized(*size) - plainly(view, *size)).max() < 1.5 / 255


def test_grey_jpegs_and_masks_are_reduced_alike(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.jpg"), images.to_uint8(smooth(480, 640))[..., 0], [cv2.IMWRITE_JPEG_QUALITY, 100])
    mask = np.zeros((480, 640), np.uint8)
    mask[100:300, 200:500] = 255
    images.write(tmp_path / "m.png", mask)
    view = viewed(tmp_path / "a.jpg", tmp_path / "m.png", 640, 480)
    found, expected = view.read_resized(32, 24), plainly(view, 32, 24)
    assert found.shape == (24, 32, 4)
    np.testing.assert_allclose(found[..., 3], expected[..., 3], atol=1e-6)  # float32 sums of 400 pixels
    assert np.abs(found - expected)[found[..., 3] == 1].max() < 1.5 / 255


@pytest.mark.parametrize("orientation", photographs.ORIENTATIONS)
def test_what_is_reduced_is_read_as_it_is_stored(tmp_path: Path, orientation: int) -> None:
    path = tmp_path / "a.jpg"
    photographs.write(path, photographs.corners(320, 256), orientation=orientation)
    stored = images.read_stored(path)
    high, wide = stored.shape[0] // 2, stored.shape[1] // 2
    small = reduced.read_stored(path, wide // 4, high // 4)
    assert small.shape == (high, wide, 3), "the premise: half of its pixels are decoded along each axis"
    assert (
        np.abs(images.as_float(small) - images.resize(images.as_float(stored), wide, high)).max() < 3 / 255
    )  # turned the wrong way, corners are off by a hundred


def test_sizes_that_do_not_divide_are_decoded_whole(tmp_path: Path) -> None:
    """Else the last pixel would be counted as wide as the others."""
    path = jpeg(tmp_path / "a.jpg", smooth(241, 321))
    assert reduced.read_stored(path, 20, 15).shape == (241, 321, 3)


def test_jpegs_that_are_cut_off_are_refused(tmp_path: Path) -> None:
    path = jpeg(tmp_path / "a.jpg", smooth(480, 640))
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(DatasetError, match="cannot be read"):
        viewed(path, width=640, height=480).read_resized(32, 24)


def test_what_follows_the_end_of_a_jpeg_does_no_harm(tmp_path: Path) -> None:
    """Phones append previews and films."""
    path = jpeg(tmp_path / "a.jpg", smooth(480, 640))
    path.write_bytes(path.read_bytes() + b"a film")
    assert reduced.read_stored(path, 20, 15).shape == (480, 640, 3)


@pytest.mark.parametrize("wrong", ["image", "mask"])
def test_sizes_are_compared_with_the_camera(tmp_path: Path, wrong: str) -> None:
    sizes: Callable[[str], tuple[int, int]] = lambda which: (30, 40) if which == wrong else (HEIGHT, WIDTH)  # noqa: E731
    images.write(tmp_path / "a.png", np.zeros((*sizes("image"), 3), np.uint8))
    images.write(tmp_path / "m.png", np.zeros(sizes("mask"), np.uint8))
    with pytest.raises(DatasetError, match="40x30, its camera says 96x64"):
        viewed(tmp_path / "a.png", tmp_path / "m.png").read_resized(24, 16)


def test_five_channels_are_refused(tmp_path: Path) -> None:
    images.write(tmp_path / "a.tif", np.zeros((HEIGHT, WIDTH, 5), np.uint8))
    with pytest.raises(DatasetError, match=r"too many channels \(5\)"):
        viewed(tmp_path / "a.tif").read_resized(24, 16)
