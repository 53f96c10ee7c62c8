"""Pictures that other programs wrote, against what those programs say of them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image

from koala3d.datasets.imaging import downscale, images
from tests.foreign import exr, photographs

WRITERS = {
    "Pillow.jpg": photographs.write,
    "OpenCV.jpg": photographs.write_with_opencv,
    "Pillow.png": photographs.write,
    "Pillow.tif": photographs.write,
}
DECODERS = 2
"""Steps of 255 by which JPEG decoders may differ; an orientation that is ignored costs a hundred in the corners."""


@pytest.mark.parametrize("orientation", photographs.ORIENTATIONS)
@pytest.mark.parametrize(("name", "write"), WRITERS.items())
def test_a_photograph_is_read_as_it_is_stored(tmp_path: Path, name: str, write: Callable[..., None], orientation: int) -> None:
    """As COLMAP reads it, whose poses belong to these pixels."""
    library = pytest.importorskip("pycolmap", reason="pycolmap is absent: it has no wheel for this platform")
    path = tmp_path / name
    write(path, photographs.corners(), orientation=orientation)
    theirs = library.Bitmap.read(path, as_rgb=True).to_array().astype(float)
    stored = images.read_stored(path)
    assert stored.dtype == np.uint8 and images.size(path) == stored.shape[1::-1] == theirs.shape[1::-1]
    assert np.abs(stored - theirs).max() <= DECODERS
    assert np.abs(255 * images.read(path) - theirs).max() <= DECODERS + 1e-3
    assert images.orientation(path) == orientation


@pytest.mark.parametrize(
    ("mode", "suffix"),
    [("1", ".png"), ("L", ".tif"), ("LA", ".png"), ("P", ".png"), ("RGBA", ".png"), ("RGBA", ".tif"), ("CMYK", ".tif")],
)
def test_pixels_of_every_kind_have_their_colours(tmp_path: Path, mode: str, suffix: str) -> None:
    """Bits, grey, a palette with transparent colours, and a printer's colours; an alpha is straight."""
    with_alpha = np.concatenate([photographs.corners(), photographs.corners()[..., :1]], axis=-1)
    picture = Image.fromarray(with_alpha).convert(mode)
    picture.save(tmp_path / f"a{suffix}")
    stored = images.read_stored(tmp_path / f"a{suffix}")
    expected = np.asarray(picture.convert({"1": "L", "P": "RGBA", "CMYK": "RGB"}.get(mode, mode)))
    assert stored.dtype == np.uint8 and np.array_equal(stored, expected.reshape(80, 120, -1))


@pytest.mark.parametrize("orientation", [1, 3, 6])
def test_a_smaller_copy_keeps_the_header_and_has_no_orientation(tmp_path: Path, orientation: int) -> None:
    said = {"Make": "Basler", "Model": "acA1920", "ExposureTime": 0.0125, "FocalLength": 8.0, "FocalLengthIn35mmFilm": 26}
    photographs.write(tmp_path / "a.jpg", photographs.corners(), orientation=orientation, **said)
    with Image.open(tmp_path / "a.jpg") as picture:
        theirs = np.asarray(picture.reduce(2)).astype(float)
    downscale.Job(tmp_path / "a.jpg", tmp_path / "small" / "a.jpg", *theirs.shape[1::-1]).run()
    kept = photographs.header_of(tmp_path / "small" / "a.jpg")
    assert {key: kept[key] for key in said} == pytest.approx(said) and kept.get("Orientation", 1) == 1
    assert np.abs(photographs.shown(tmp_path / "small" / "a.jpg") - theirs).max() < 12  # two encodings


@pytest.mark.parametrize("kind", ["half", "float"])
@pytest.mark.parametrize("names", ["RGB", "BGR", "Y", "YA", "RGBA", "ABGR"])
def test_channels_of_an_exr_are_found_by_their_names(tmp_path: Path, names: str, kind: str) -> None:
    """Linear light far above one; colours that alpha does not weaken, and alpha itself everywhere."""
    random = np.random.default_rng(0)
    channels = {name: random.uniform(0, 50, (80, 120)).astype(np.float32) for name in names}
    if "A" in names:
        channels["A"] = np.linspace(-0.5, 1.5, 120, dtype=np.float32).clip(0, 1) * np.ones((80, 1), np.float32)
    exr.write(tmp_path / "a.exr", channels, kind)
    known = exr.read(tmp_path / "a.exr")
    assert all(np.allclose(known[name], channels[name], rtol=5e-4, atol=1e-7) for name in names)  # half floats have 11 bits
    found = images.read(tmp_path / "a.exr")
    assert list(known) == [name for name in "RGBYA" if name in names] and found.shape == (80, 120, len(names))
    cover = np.where(known.get("A", np.ones((80, 120))) > 0, known.get("A", np.ones((80, 120))), 1)
    for name, values in zip(known, np.moveaxis(found, -1, 0), strict=True):  # EXR's colours are multiplied by their alpha
        np.testing.assert_allclose(values, known[name] if name == "A" else known[name] / cover, rtol=1e-6, err_msg=name)


def test_an_exr_that_koala_writes_has_colours_that_are_multiplied_by_their_alpha(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).uniform(0, 2, (8, 6, 4)).astype(np.float32)
    picture[..., 3] = np.linspace(0.1, 1, 6)
    images.write(tmp_path / "a.exr", picture)
    stored = exr.read(tmp_path / "a.exr")
    for name, values in zip("RGB", np.moveaxis(picture, -1, 0)[:3], strict=True):
        np.testing.assert_allclose(stored[name], values * picture[..., 3], rtol=1e-6)
    np.testing.assert_allclose(images.read(tmp_path / "a.exr"), picture, rtol=1e-6)  # float32


@pytest.mark.parametrize("alpha", [None, "A"])
def test_further_channels_of_an_exr_are_no_alpha(tmp_path: Path, alpha: str | None) -> None:
    """Blender writes the depth as Z beside the colours; renderers write what they like."""
    random = np.random.default_rng(0)
    names = [*"RGB", *([alpha] if alpha else []), "Z", "ViewLayer.Normal.X"]
    channels = {name: random.uniform(1, 2, (8, 6)).astype(np.float32) for name in names}
    exr.write(tmp_path / "a.exr", channels, "float")
    found = images.read(tmp_path / "a.exr")
    assert found.shape[-1] == images.channels(tmp_path / "a.exr") == (4 if alpha else 3)
    np.testing.assert_allclose(found[..., 0] * (channels["A"] if alpha else 1), channels["R"], rtol=1e-6)


@pytest.mark.parametrize("left, top", [(2, 3), (-2, -1), (7, 5)])
def test_the_part_that_an_exr_holds_is_put_in_its_place(tmp_path: Path, left: int, top: int) -> None:
    """Renderers crop what is empty, or write more than the picture: the data window differs from the display window."""
    held = np.random.default_rng(0).uniform(1, 2, (4, 6)).astype(np.float32)
    exr.write(tmp_path / "a.exr", {name: held for name in "RGB"}, "float", window=(left, top), display=(10, 8))
    whole = np.pad(held, ((20, 20), (20, 20)))[20 - top : 28 - top, 20 - left : 30 - left]
    assert images.size(tmp_path / "a.exr") == (10, 8)
    assert np.array_equal(images.read(tmp_path / "a.exr")[..., 0], whole)


@pytest.mark.parametrize("associated", [False, True])
def test_a_tiff_says_whether_its_colours_are_multiplied(tmp_path: Path, associated: bool) -> None:
    """Tag 338, written by OpenImageIO; the picture is the same."""
    straight = np.full((8, 6, 4), (200, 100, 50, 128), np.uint8)
    spec = oiio.ImageSpec(6, 8, 4, "uint8")
    spec.attribute("oiio:UnassociatedAlpha", int(not associated))
    buffer = oiio.ImageBuf(spec)
    multiplied = np.concatenate([np.rint(straight[..., :3] * (128 / 255)).astype(np.uint8), straight[..., 3:]], -1)
    buffer.set_pixels(oiio.ROI(), multiplied if associated else straight)
    assert buffer.write(str(tmp_path / "a.tif"))
    assert np.abs(images.read_stored(tmp_path / "a.tif").astype(int) - straight).max() <= (1 if associated else 0)
