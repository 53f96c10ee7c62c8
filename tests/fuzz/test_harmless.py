"""Files that are written differently and say the same come to the same: each kind of scene, with each harmless change."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from koala3d.datasets.formats import load_scene
from koala3d.datasets.scene import Scene
from tests.fuzz.sound import LAYOUTS, sound_inputs

TEXTS = (".json", ".txt", ".csv", ".yaml")
Change = Callable[[Path], None]


def with_mark(path: Path) -> None:
    """The byte order mark of Excel and Notepad."""
    if path.suffix in TEXTS:
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())


def in_utf16(path: Path) -> None:
    """What PowerShell's `>` writes."""
    if path.suffix in TEXTS:
        path.write_text(path.read_text(encoding="utf-8"), encoding="utf-16")


def with_windows_ends(path: Path) -> None:
    if path.suffix in TEXTS:
        path.write_bytes(path.read_bytes().replace(b"\r\n", b"\n").replace(b"\n", b"\r\n"))


def in_another_order(path: Path) -> None:
    """Keys of JSON by name, in one line."""
    if path.suffix == ".json":
        path.write_text(json.dumps(json.loads(path.read_text()), sort_keys=True))


def compressed_again(path: Path) -> None:
    """The same pixels of a PNG in other bytes, beside a header that says that they are turned."""
    if path.suffix == ".png":
        header = Image.Exif()
        header[0x112] = 6
        with Image.open(path) as picture:
            picture.save(path, compress_level=1, exif=header)


def with_a_header(path: Path) -> None:
    """A JPEG whose EXIF header says that it is turned; its pixels are not touched."""
    if path.suffix == ".jpg":
        header = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
        content = path.read_bytes()
        path.write_bytes(content[:2] + b"\xff\xe1" + (len(header) + 2).to_bytes(2, "big") + header + content[2:])


CHANGES = (with_mark, in_utf16, with_windows_ends, in_another_order, compressed_again, with_a_header)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    every = sound_inputs(tmp_path_factory.mktemp("sound"))
    return {kind: folder for kind, folder in every.items() if kind.removesuffix("-bare") in LAYOUTS}


def same(one: Scene, other: Scene) -> bool:
    """Whether two scenes have the same views, space and points."""
    for a, b in zip(one.views, other.views, strict=True):
        if (a.name, a.split, a.camera, sorted(a.truth)) != (b.name, b.split, b.camera, sorted(b.truth)):
            return False
        if not (np.array_equal(a.world_from_camera, b.world_from_camera) and np.array_equal(a.read(), b.read())):
            return False
    space = np.array_equal(one.box, other.box) and (one.near, one.far, one.background) == (
        other.near,
        other.far,
        other.background,
    )
    points = (one.points is None) == (other.points is None) and (one.points is None or np.array_equal(one.points, other.points))
    return space and points


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
def test_harmless_changes_change_nothing(inputs: dict[str, Path], tmp_path: Path, change: Change) -> None:
    changed = 0
    for kind, folder in inputs.items():
        before = load_scene(folder)
        shutil.copytree(folder, tmp_path / kind)
        for path in (tmp_path / kind).rglob("*"):
            if path.is_file():
                content = path.read_bytes()
                change(path)
                changed += content != path.read_bytes()
        after = load_scene(tmp_path / kind)
        assert same(before, after), kind
    assert changed >= 3, "the premise: there are such files"
