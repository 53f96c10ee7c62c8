"""Upright copies of pictures with an orientation tag, and copies without the tag, as Pillow shows them."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from koala3d.datasets.imaging import images, orientation
from tests.foreign import photographs

ROUNDING = 3
"""Steps of 255: the integer cosine transform of JPEG decoders is not the same for rows and for columns."""
ENCODED_AGAIN = 6
"""Steps of 255 by which JPEG of quality 95 changes the smooth picture."""


@pytest.mark.parametrize("turn", photographs.ORIENTATIONS)
@pytest.mark.parametrize(("suffix", "size"), [(".jpg", (160, 96)), (".jpg", (120, 82)), (".png", (121, 81)), (".tif", (121, 81))])
def test_an_upright_copy_is_what_a_viewer_shows(tmp_path: Path, suffix: str, size: tuple[int, int], turn: int) -> None:
    source, target = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    photographs.write(source, photographs.corners(*size), orientation=turn, Make="Koala")
    kept = orientation.write_upright(source, target)
    blocks_fill_it = suffix != ".jpg" or size == (160, 96)
    assert kept == blocks_fill_it
    allowed = {True: ROUNDING, False: ENCODED_AGAIN}[kept] if suffix == ".jpg" else 0
    with Image.open(target) as picture:
        stored = np.asarray(picture).astype(float)
    assert stored.shape[1::-1] == size and np.abs(stored - photographs.shown(source)).max() <= allowed
    assert images.orientation(target) == 1 and photographs.header_of(target)["Make"] == "Koala"


@pytest.mark.parametrize("sampling", ["4:4:4", "4:2:2", "4:2:0"])
def test_colours_of_every_resolution_are_moved(tmp_path: Path, sampling: str) -> None:
    """Blocks of colour cover one, two or four blocks of brightness."""
    picture = Image.fromarray(photographs.corners(160, 96)).transpose(photographs.STORED[6])
    picture.save(tmp_path / "a.jpg", exif=photographs.exif(6), quality=90, subsampling=sampling)
    assert orientation.write_upright(tmp_path / "a.jpg", tmp_path / "b.jpg")
    change = photographs.shown(tmp_path / "b.jpg").astype(float) - photographs.shown(tmp_path / "a.jpg")
    assert np.abs(change).max() <= ROUNDING


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif"])
def test_a_copy_without_the_tag_has_the_stored_pixels(tmp_path: Path, name: str) -> None:
    photographs.write(tmp_path / name, photographs.corners(), orientation=6, Make="Koala")
    orientation.write_untagged(tmp_path / name, tmp_path / f"b_{name}")
    library = pytest.importorskip("pycolmap", reason="pycolmap is absent: it has no wheel for this platform")
    stored = library.Bitmap.read(tmp_path / name, as_rgb=True).to_array()
    with Image.open(tmp_path / f"b_{name}") as copy:
        assert np.array_equal(np.asarray(copy), stored) and copy.getexif().get(0x112, 1) == 1
    assert photographs.header_of(tmp_path / f"b_{name}")["Make"] == "Koala"
