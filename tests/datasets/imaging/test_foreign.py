"""Pictures that other programs wrote, against what those programs say of them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
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
def test_a_photograph_is_read_as_a_viewer_shows_it(
    tmp_path: Path, name: str, write: Callable[..., None], orientation: int
) -> None:
    path, picture = tmp_path / name, photographs.corners()
    write(path, picture, orientation=orientation)
    shown = photographs.shown(path)
    assert np.abs(shown - picture.astype(float)).max() < 6, "the premise: JPEG of this quality keeps the smooth picture"
    stored = images.read_stored(path)
    assert stored.dtype == np.uint8 and images.size(path) == (120, 80) == stored.shape[1::-1]
    assert np.abs(stored - shown.astype(float)).max() <= DECODERS
    assert np.abs(255 * images.read(path) - shown).max() <= DECODERS + 1e-3


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
def test_a_smaller_copy_is_upright_and_keeps_the_header(tmp_path: Path, orientation: int) -> None:
    said = {"Make": "Basler", "Model": "acA1920", "ExposureTime": 0.0125, "FocalLength": 8.0, "FocalLengthIn35mmFilm": 26}
    photographs.write(tmp_path / "a.jpg", photographs.corners(), orientation=orientation, **said)
    downscale.Job(tmp_path / "a.jpg", tmp_path / "small" / "a.jpg", 60, 40).run()
    kept = photographs.header_of(tmp_path / "small" / "a.jpg")
    assert {key: kept[key] for key in said} == pytest.approx(said) and kept.get("Orientation", 1) == 1
    small = photographs.shown(tmp_path / "small" / "a.jpg").astype(float)
    theirs = np.asarray(Image.fromarray(photographs.corners()).reduce(2))
    assert np.abs(small - theirs).max() < 12  # two encodings


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
    opaque = known.get("A", np.ones((80, 120))) == 1
    for name, values in zip(known, np.moveaxis(found, -1, 0), strict=True):
        counted = slice(None) if name == "A" else opaque
        assert np.array_equal(values[counted], known[name][counted]), name
