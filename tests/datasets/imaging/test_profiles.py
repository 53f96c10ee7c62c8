"""Pictures in other colours than sRGB's, against littleCMS."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.imaging import images, profiles, reduced
from tests.foreign import icc, photographs

P3, ADOBE = icc.profile(icc.DISPLAY_P3, icc.SRGB_CURVE), icc.profile(icc.ADOBE_RGB, icc.ADOBE_CURVE)
TABLE = icc.profile(icc.ADOBE_RGB, icc.table_curve(2.2))
ROUNDING = 2
"""Steps of 255: littleCMS computes 8-bit pictures in fixed point."""


@pytest.mark.parametrize("profile", [P3, ADOBE, TABLE], ids=["Display P3", "Adobe RGB", "curves of a table"])
@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg"])
def test_colours_are_converted_to_srgb(tmp_path: Path, profile: bytes, suffix: str) -> None:
    picture = Image.fromarray(photographs.corners())
    picture.save(tmp_path / f"a{suffix}", icc_profile=profile, quality=98)
    with Image.open(tmp_path / f"a{suffix}") as stored:
        plain = np.asarray(stored)
    expected = icc.in_srgb(plain, profile)
    assert np.abs(expected.astype(int) - plain).max() > 10, "the premise: the colours differ"
    found = images.read_stored(tmp_path / f"a{suffix}").astype(int)
    assert found.dtype == int and np.abs(found - expected).max() <= ROUNDING + (2 if suffix == ".jpg" else 0)


def test_a_picture_that_is_decoded_small_is_converted_too(tmp_path: Path) -> None:
    Image.fromarray(photographs.corners(640, 480)).save(tmp_path / "a.jpg", icc_profile=P3, quality=98)
    small = reduced.read_stored(tmp_path / "a.jpg", 40, 30)
    whole = images.resize(images.as_float(images.read_stored(tmp_path / "a.jpg")), 160, 120)
    assert small.shape == (120, 160, 3) and np.abs(images.as_float(small) - whole).mean() < 0.5 / 255


def test_sixteen_bits_stay_sixteen_bits(tmp_path: Path) -> None:
    """Between the values of 8 bits; written by OpenImageIO."""
    import OpenImageIO as oiio

    fine = np.linspace(0.2, 0.3, 6000).reshape(20, 100, 3).astype(np.float32)
    spec = oiio.ImageSpec(100, 20, 3, "uint16")
    spec.attribute("ICCProfile", f"uint8[{len(ADOBE)}]", np.frombuffer(ADOBE, np.uint8))
    buffer = oiio.ImageBuf(spec)
    buffer.set_pixels(oiio.ROI(), fine)
    assert buffer.write(str(tmp_path / "a.png"))
    stored = images.read_stored(tmp_path / "a.png")
    light = (fine.astype(float) ** (563 / 256)) @ (np.linalg.inv(np.array(icc.SRGB)) @ np.array(icc.ADOBE_RGB)).T
    expected = images.srgb_from_linear(np.clip(light, 0, 1))
    assert stored.dtype == np.uint16 and np.abs(stored / 65535 - expected).max() < 5e-4  # five digits of the primaries


@pytest.mark.parametrize("profile", [icc.profile(icc.SRGB, icc.SRGB_CURVE), b"", b"short"])
def test_srgb_and_what_is_no_profile_change_nothing(tmp_path: Path, profile: bytes) -> None:
    assert profiles.conversion(profile) is None
    Image.fromarray(photographs.corners()).save(tmp_path / "a.png", icc_profile=profile or None)
    assert np.array_equal(images.read_stored(tmp_path / "a.png"), photographs.corners())


def test_a_profile_of_tables_is_refused(tmp_path: Path) -> None:
    scanner = P3.replace(b"rTRC", b"A2B0").replace(b"rXYZ", b"B2A0")
    Image.fromarray(photographs.corners()).save(tmp_path / "a.png", icc_profile=scanner)
    with pytest.raises(DatasetError, match=r"colour profile of the image cannot be followed.*; convert the image to sRGB"):
        images.read(tmp_path / "a.png")


def test_damaged_profiles_end_in_one_kind_of_error() -> None:
    random, refused = np.random.default_rng(0), 0
    for _ in range(300):
        damaged = np.frombuffer(TABLE, np.uint8).copy()
        damaged[random.integers(128, len(damaged), 4)] = random.integers(0, 256, 4)
        try:
            profiles.conversion(damaged.tobytes()[: int(random.integers(100, len(damaged) + 1))])
        except profiles.Unreadable:
            refused += 1
    assert 0 < refused < 300
