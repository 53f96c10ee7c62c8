"""Ways to corrupt a sound input, each from its number alone.

Each returns whether an error must follow; None where it does not apply.
"""

import json
import os
import random
import shutil
import struct
from pathlib import Path

import bombs
import numpy as np
import yaml
from structure import BAD, Structure, leaves, put

PICTURES = (".png", ".jpg", ".tif", ".exr")
PATH_KEYS = ("image", "mask", "file_path", "mask_path", "depth_file_path", "depth", "ply_file_path")
BINARY = (".bin", ".npy", ".npz")
BAGS = (".db3", ".mcap", ".bag")
UNREAD = ("rigs.bin", "frames.bin")
"""Files of a COLMAP model that nobody reads."""


class Damage(Structure):
    """One input to be corrupted, with its random numbers and the folder outside that nobody may touch."""

    def __init__(self, folder: Path, outside: Path, seed: int) -> None:
        self.folder, self.outside, self.random = folder, outside, random.Random(seed)
        self.files = sorted(path for path in folder.rglob("*") if path.is_file())

    def pick(self, *suffixes: str) -> Path | None:
        """One file with one of the suffixes; None where there is none. No suffix: any."""
        chosen = [path for path in self.files if not suffixes or path.suffix in suffixes]
        return self.random.choice(chosen) if chosen else None

    def any(self) -> Path:
        """One file."""
        return self.random.choice(self.files)

    def truncate(self) -> bool:
        path = self.any()
        data = path.read_bytes()
        path.write_bytes(data[: self.random.randrange(len(data))] if data else b"")
        return False  # a text may still be whole, a mask unused

    def cut_table(self) -> bool | None:
        """A binary table loses its end: always an error."""
        path = self.pick(*BINARY)
        if path is None or path.name in UNREAD:
            return None
        data = path.read_bytes()
        path.write_bytes(data[: self.random.randrange(len(data) - 1)])
        return True

    def cut_picture(self) -> bool | None:
        path = self.pick(*PICTURES)
        if path is None:
            return None
        data = path.read_bytes()
        path.write_bytes(data[: self.random.randrange(len(data))])
        return False

    def flip(self) -> bool:
        """Some bytes become others."""
        path = self.any()
        data = bytearray(path.read_bytes())
        for _ in range(self.random.randint(1, 20)):
            if data:
                data[self.random.randrange(len(data))] = self.random.randrange(256)
        path.write_bytes(data)
        return False

    def flip_bit(self) -> bool:
        """One bit of a file that is not text."""
        path = self.pick(*PICTURES, *BINARY, *BAGS, ".ply", ".glb", ".stl", "") or self.any()
        data = bytearray(path.read_bytes())
        if data:
            data[self.random.randrange(len(data))] ^= 1 << self.random.randrange(8)
        path.write_bytes(data)
        return False

    def swap_files(self) -> bool | None:
        """Two files have each other's content."""
        if len(self.files) < 2:
            return None
        first, second = self.random.sample(self.files, 2)
        data = first.read_bytes()
        first.write_bytes(second.read_bytes())
        second.write_bytes(data)
        return False

    def remove(self) -> bool:
        self.any().unlink()
        return False

    def huge_number(self) -> bool | None:
        """A count or size in a binary table becomes enormous."""
        path = self.pick(".bin", ".npz", *BAGS)
        if path is None:
            return None
        data = bytearray(path.read_bytes())
        width, value = self.random.choice(((8, 2 ** self.random.randint(20, 63)), (4, 2 ** self.random.randint(20, 31))))
        at = self.random.choice((0, self.random.randrange(max(len(data) - width, 1))))
        data[at : at + width] = value.to_bytes(width, "little")
        path.write_bytes(data)
        return path.suffix == ".bin" and at == 0 and width == 8 and path.name not in UNREAD

    def _outside_name(self) -> str:
        secret = self.outside / "secret.png"
        return self.random.choice(
            (
                f"../../{self.outside.name}/secret.png",
                str(secret),
                f"images/../../../{self.outside.name}/secret.png",
                f"../../{self.outside.name}/secret",
                "/etc/passwd",
            )
        )

    def traverse_json(self) -> bool | None:
        """A path in a file leaves the folder. That of a picture may stand for its namesake inside; depth is not read."""
        path = self.pick(".json")
        if path is None or path.name == "calibration.json":
            return None
        content = json.loads(path.read_text())
        places = [place for place in leaves(content) if place[-1] in PATH_KEYS]
        if not places:
            return None
        place = self.random.choice(places)
        put(content, place, self._outside_name())
        path.write_text(json.dumps(content))
        return place[-1] not in ("file_path", "depth_file_path")

    def traverse_table(self) -> bool | None:
        path = next((p for p in self.files if p.name in ("images.bin", "images.txt")), None)
        if path is None:
            return None
        path.write_bytes(path.read_bytes().replace(b"1.jpg", self._outside_name().encode()))
        return True

    def traverse_label(self) -> bool | None:
        """The name of a picture in the export of a capture program leaves the folder: it may stand for its namesake inside."""
        path = next((p for p in self.files if p.name in ("cameras.xml", "cameras.csv")), None)
        if path is None:
            return None
        name = b"b.JPG" if path.suffix == ".xml" else b"1.png"
        path.write_bytes(path.read_bytes().replace(name, self._outside_name().encode()))
        return False

    def entities(self) -> bool | None:
        """XML whose entities stand for billions of letters, or for a file outside."""
        path = self.pick(".xml")
        if path is None or b"<document" not in (data := path.read_bytes()):
            return None
        trap = self.random.choice((f'<!ENTITY a SYSTEM "{self.outside / "secret.png"}">', bombs.entities(9)))
        trapped = data.replace(b"<document", f"<!DOCTYPE d [{trap}]><document".encode(), 1)
        path.write_bytes(trapped.replace(b"label='1'", b"label='&a;'"))
        return True

    def traverse_pattern(self) -> bool | None:
        """A pattern of file names in a description leaves the folder."""
        path = self.pick(".yaml")
        if path is None or "images" not in (content := yaml.safe_load(path.read_text())):
            return None
        pattern = self.random.choice(
            (f"../../{self.outside.name}/*", f"{self.outside}/*.png", "../*/*.png", "/etc/pass*", "**/*.png")
        )
        content[self.random.choice(("images", "poses"))] = pattern
        path.write_text(yaml.safe_dump(content))
        return not pattern.startswith("**")

    def traverse_frame(self) -> bool | None:
        """A frame of a recording names an image, or itself, outside."""
        path = next((p for p in self.files if p.name == "frames.jsonl"), None)
        if path is None:
            return None
        lines = [json.loads(line) for line in path.read_text().splitlines()]
        key = self.random.choice(("image", "name"))
        self.random.choice(lines)[key] = self._outside_name()
        path.write_text("".join(json.dumps(line) + "\n" for line in lines))
        return key == "image"

    def link_round(self) -> bool:
        path = self.any()
        path.unlink()
        path.symlink_to(path.name)
        return False

    def special_file(self) -> bool:
        """A folder, a named pipe or a device instead of a file: whoever waits for its end waits for ever."""
        path = self.any()
        path.unlink()
        way = self.random.randrange(3)
        if way == 0:
            path.mkdir()
        elif way == 1:
            os.mkfifo(path)
        else:
            path.symlink_to("/dev/zero")
        return False

    def bomb(self) -> bool | None:
        """A picture whose header promises more than it can hold."""
        path = self.pick(*PICTURES)
        if path is None:
            return None
        side = self.random.choice((31623, 65000, 2**31 - 1))
        way = self.random.choice((bombs.png_header, bombs.jpeg_header, bombs.tiff_header))
        path.write_bytes(way(side))
        return path.parent.name in ("images", "image", "train", "test")  # the rest may be there for other programs

    def pixel_bomb(self) -> bool | None:
        """A picture that decodes without a fault, to a thousand times its size."""
        path = self.pick(".png")
        if path is None:
            return None
        path.write_bytes(bombs.png_of_zeros(self.random.choice((6000, 16384))))
        return False

    def nan_everywhere(self) -> bool | None:
        """Every number of the poses is NaN or infinite: always an error."""
        bad = self.random.choice((np.nan, np.inf, -np.inf))
        path = self.pick(".json", ".npy", ".npz")
        if path is None:
            return None
        if path.suffix == ".npy":
            np.save(path, np.full_like(np.load(path), bad))
        elif path.suffix == ".npz" and path.name != "points.npz":
            with np.load(path) as stored:
                broken = {name: np.full_like(stored[name], bad) for name in stored.files}
            np.savez(path, **broken)
        elif path.suffix == ".json" and path.name != "koala.json":
            content = json.loads(path.read_text())
            places = [place for place in leaves(content) if {"world_from_camera", "transform_matrix", "camera"} & set(place)]
            for place in places:
                put(content, place, bad)
            path.write_text(json.dumps(content))
            return bool(places)
        else:
            return None
        return True

    def pickled(self) -> bool | None:
        path = self.pick(".npy", ".npz")
        if path is None:
            return None
        bombs.pickled(path, self.outside / "sprung", self.random.randrange(3))
        return True

    def zip_bomb(self) -> bool | None:
        path = self.pick(".npz")
        if path is None:
            return None
        bombs.zip_bomb(path)
        return True

    def huge_shape(self) -> bool | None:
        path = self.pick(".npy")
        if path is None:
            return None
        shapes = ("(1000000000000, 17)", "(-1, 17)", "(3, 17" + ", 99999" * 8 + ")", "(" * 300, "(17,) * 10**9")
        header = ("{'descr': '<f8', 'fortran_order': False, 'shape': " + self.random.choice(shapes) + ", }").encode().ljust(
            600
        ) + b"\n"
        path.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + b"\0" * 1000)
        return True

    def words(self) -> bool | None:
        """Words of a table in text become others."""
        path = self.pick(".txt", ".csv", ".xml")
        if path is None:
            return None
        gap = "," if path.suffix == ".csv" else " "
        words = path.read_text().split(gap)
        bad = ("nan", "inf", "-1", "99999999999999999999", "x", "", "\x00", "1e999", "é" * 100, '"', "9" * 200_000)
        for _ in range(self.random.randint(1, 4)):
            words[self.random.randrange(len(words))] = self.random.choice(bad)
        path.write_text(gap.join(words))
        return False

    def points_header(self) -> bool | None:
        """A PLY file with another header: order of bytes, counts, types, elements."""
        path = self.pick(".ply")
        if path is None:
            return None
        before, after = self.random.choice(
            (
                (b"binary_little_endian", b"binary_big_endian"),
                (b"ascii", b"binary_big_endian"),
                (b"vertex ", b"vertex 99999999999999"),
                (b"vertex ", b"vertex -"),
                (b"double x", b"list uchar int x"),
                (b"float y", b"char y"),
                (b"double z", b"double x"),
                (b"element vertex", b"element face 5\nproperty list uchar int a\nelement vertex"),
                (b"end_header\n", b"end_header\r\n"),
                (b"\n", b"\r\n"),
                (b"ply\n", b"ply\r"),
                (b"format", b"comment " + b"x" * 70_000 + b"\nformat"),
                (b"property", b"property float"),
                (b"end_header", b"property double w\n" * 3000 + b"end_header"),
                (b"double x", b"double \xff\xfe"),
            )
        )
        head, end, body = path.read_bytes().partition(b"end_header\n")
        path.write_bytes((head + end).replace(before, after, 1 if before != b"\n" else -1) + body)
        return False

    def glb_header(self) -> bool | None:
        """The description inside a GLB file says something else, or asks for much."""
        path = self.pick(".glb")
        if path is None:
            return None
        data = path.read_bytes()
        length = int.from_bytes(data[12:16], "little")
        content = json.loads(data[20 : 20 + length])
        way = self.random.randrange(5)
        if way == 0:
            content["accessors"][0] = {"componentType": 5126, "type": "MAT4", "count": 10**8}
        elif way == 1:  # each part holds the next one twice: 2^40 copies
            content["nodes"] += [{"children": [number + 1, number + 1], "mesh": 0} for number in range(len(content["nodes"]), 40)]
        elif way == 2:
            content["buffers"][0]["uri"] = self._outside_name()
        else:
            place = self.random.choice(leaves(content))
            put(content, place[: self.random.randint(1, len(place))], self.random.choice(BAD))
        text = json.dumps(content).encode()
        text += b" " * (-len(text) % 4)
        path.write_bytes(data[:12] + len(text).to_bytes(4, "little") + data[16:20] + text + data[20 + length :])
        return way < 3

    def garbage(self) -> bool:
        self.any().write_bytes(self.random.randbytes(self.random.choice((0, 1, 7, 100, 10_000))))
        return False

    def crowd(self) -> bool:
        """A folder holds thousands of files more than anybody speaks of."""
        home = self.any().parent
        for number in range(3000):
            (home / f"{number:05d}{self.random.choice(('.png', '.json', ''))}").touch()
        return False

    def copy_checkpoint(self) -> bool | None:
        """A newer checkpoint that is empty, or only half there."""
        newest = max(self.folder.glob("checkpoints/[0-9]*"), default=None)
        if newest is None:
            return None
        other = newest.with_name("00000009")
        other.mkdir()
        if self.random.random() < 0.7:
            shutil.copytree(newest, other, dirs_exist_ok=True)
            path = self.random.choice([path for path in other.rglob("*") if path.is_file()])
            path.unlink()
        return False


WAYS: tuple[str, ...] = (
    "truncate",
    "cut_table",
    "cut_picture",
    "flip",
    "flip_bit",
    "flip_bit",
    "swap_files",
    "remove",
    "huge_number",
    "traverse_json",
    "traverse_table",
    "traverse_label",
    "traverse_pattern",
    "traverse_frame",
    "link_round",
    "special_file",
    "bomb",
    "pixel_bomb",
    "nan_everywhere",
    "pickled",
    "zip_bomb",
    "entities",
    "huge_shape",
    "words",
    "points_header",
    "glb_header",
    "garbage",
    "crowd",
    "copy_checkpoint",
    "bad_value",
    "bad_value",
    "nested_type",
    "nested_type",
    "drop_key",
    "odd_name",
    "odd_name",
    "odd_key",
    "truth_key",
    "duplicate_key",
    "huge_count",
    "encoding",
    "deep",
    "digits",
    "alias_bomb",
    "alias_bomb",
)
"""Names of the ways; what is worth more attempts stands here twice."""
