"""Exports of capture programs that are damaged at random are read, or refused with one clear line."""

import random
from collections.abc import Callable
from pathlib import Path

import pytest

from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.formats import load_scene
from tests.datasets.formats.captures import test_bop, test_metashape, test_phones, test_reality


def of_realityscan(folder: Path) -> None:
    test_reality.export(
        folder, [test_reality.row(f"{k}.png", k, 0, 0, 10 * k, 80, 0, 20.0, *[0.01] * 4, 0.0, 0.0, 0, 0) for k in (1, 2)]
    )


@pytest.mark.parametrize(
    ("format", "write", "name"),
    [
        ("metashape", test_metashape.export, "cameras.xml"),
        ("realityscan", of_realityscan, "cameras.csv"),
        ("bop", test_bop.written, "scene_camera.json"),
        ("bop", test_bop.written, "scene_gt.json"),
        ("phone", test_phones.of_polycam, "keyframes/corrected_cameras/1002.json"),
        ("phone", test_phones.of_record3d, "EXR_RGBD/metadata.json"),
        ("phone", test_phones.of_scanner, "frame_00002.json"),
    ],
)
def test_damage_is_survived(tmp_path: Path, format: str, write: Callable[[Path], object], name: str) -> None:
    folder, choice, refused = tmp_path / "scan", random.Random(0), 0
    write(folder)
    whole = (folder / name).read_bytes()
    for _ in range(60):
        data = bytearray(whole)
        for _ in range(choice.randint(1, 4)):
            place = choice.randrange(len(data))
            data[place : place + choice.randint(1, 8)] = choice.choice(
                [b"", b"9", b"-", b"null", b"e999", b'"', b"<", bytes([choice.randrange(256)])]
            )
        (folder / name).write_bytes(data)
        try:
            load_scene(folder, format=format)
        except KoalaError as error:
            refused += 1
            assert "\n" not in str(error)
    assert refused > 10
