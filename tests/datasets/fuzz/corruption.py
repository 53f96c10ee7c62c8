"""Ways to corrupt a sound input, each from its number alone."""

import json
import os
import pickle
import random
import shutil
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

PICTURES = (".png", ".jpg", ".tif", ".exr")


class Corruption:
    """One way to corrupt, with its random numbers and the folder outside that nobody may read."""

    def __init__(self, folder: Path, outside: Path, seed: int) -> None:
        self.folder, self.outside, self.random = folder, outside, random.Random(seed)
        self.files = sorted(path for path in folder.rglob("*") if path.is_file())

    def pick(self, *suffixes: str) -> Path | None:
        """One file with one of the suffixes; None where there is none. No suffix: any."""
        chosen = [path for path in self.files if not suffixes or path.suffix in suffixes]
        return self.random.choice(chosen) if chosen else None

    def truncate(self) -> bool:
        path = self.pick()
        data = path.read_bytes()
        path.write_bytes(data[: self.random.randrange(len(data))] if data else b"")
        return False  # a text may still be whole, a mask unused

    def cut_table(self) -> bool | None:
        """A binary table loses its end: always an error."""
        path = self.pick(".bin", ".npy", ".npz")
        if path is None or path.name in ("rigs.bin", "frames.bin"):
            return None
        data = path.read_bytes()
        path.write_bytes(data[: self.random.randrange(len(data) - 1)])
        return path.name not in ("points.npz",) or len(data) > 0

    def flip(self) -> bool:
        path = self.pick()
        data = bytearray(path.read_bytes())
        for _ in range(self.random.randint(1, 20)):
            if data:
                data[self.random.randrange(len(data))] = self.random.randrange(256)
        path.write_bytes(data)
        return False

    def huge_number(self) -> bool | None:
        path = self.pick(".bin", ".npy", ".npz")
        if path is None:
            return None
        data = bytearray(path.read_bytes())
        width, value = self.random.choice(((8, 2 ** self.random.randint(20, 63)), (4, 2 ** self.random.randint(20, 31))))
        at = self.random.choice((0, self.random.randrange(max(len(data) - width, 1))))
        data[at : at + width] = value.to_bytes(width, "little")
        path.write_bytes(data)
        return path.suffix == ".bin" and at == 0 and width == 8 and path.name not in ("rigs.bin", "frames.bin")

    def outside_name(self) -> str:
        secret = self.outside / "secret.png"
        return self.random.choice((f"../../{self.outside.name}/secret.png", str(secret), f"images/../../../{self.outside.name}/secret.png",
                                   f"../../{self.outside.name}/secret"))  # fmt: skip

    def traverse_json(self) -> bool | None:
        path = self.pick(".json")
        if path is None or path.name == "calibration.json":
            return None
        content = json.loads(path.read_text())
        places = [
            place
            for place in leaves(content)
            if place[-1] in ("image", "mask", "file_path", "mask_path", "depth_file_path", "depth")
        ]
        if not places:
            return None
        put(content, self.random.choice(places), self.outside_name())
        path.write_text(json.dumps(content))
        return True

    def traverse_table(self) -> bool | None:
        path = next((p for p in self.files if p.name in ("images.bin", "images.txt")), None)
        if path is None:
            return None
        name = self.outside_name().encode()
        path.write_bytes(path.read_bytes().replace(b"1.jpg", name))
        return True

    def link_out(self) -> bool | None:
        """A file or the folder of images becomes a link to one outside that looks the same."""
        twin = self.outside / "twin"
        shutil.rmtree(twin, ignore_errors=True)
        shutil.copytree(self.folder, twin)
        path = self.pick()
        if path.name == "calibration.json":  # is named by whoever asks for it, and may be anywhere
            return None
        if self.random.random() < 0.3 and path.parent != self.folder and path.parent.parent == self.folder:
            path = path.parent
        target = twin / path.relative_to(self.folder)
        shutil.rmtree(path) if path.is_dir() else path.unlink()
        path.symlink_to(target if self.random.random() < 0.5 else os.path.relpath(target, path.parent.resolve()))
        return False  # what nobody wants may be a link: that nothing outside is opened is watched

    def link_round(self) -> bool:
        path = self.pick()
        path.unlink()
        path.symlink_to(path.name)
        return False

    def bomb(self) -> bool | None:
        path = self.pick(*PICTURES)
        if path is None:
            return None
        side = self.random.choice((31623, 65000, 2**31 - 1))
        kind = self.random.choice((".png", ".jpg", ".tif"))
        path.write_bytes({".png": png_header(side), ".jpg": jpeg_header(side), ".tif": tiff_header(side)}[kind])
        return path.parent.name in ("images", "image", "train", "test")  # the rest may be there for other programs

    def bad_value(self) -> bool | None:
        path = self.pick(".json", ".jsonl")
        if path is None:
            return None
        text = path.read_text()
        content = [json.loads(line) for line in text.splitlines()] if path.suffix == ".jsonl" else json.loads(text)
        place = self.random.choice(leaves(content))
        bad: list[Any] = [
            float("nan"),
            float("inf"),
            -float("inf"),
            -1,
            0,
            1e308,
            10**30,
            "x",
            None,
            [],
            {},
            True,
            [[[]]],
            "\0",
            "a" * 5000,
        ]
        put(content, place, self.random.choice(bad))
        path.write_text("".join(json.dumps(line) + "\n" for line in content) if path.suffix == ".jsonl" else json.dumps(content))
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

    def drop_key(self) -> bool | None:
        path = self.pick(".json")
        if path is None:
            return None
        content = json.loads(path.read_text())
        place = self.random.choice(leaves(content))
        place = place[: self.random.randint(1, len(place))]
        holder = content
        for key in place[:-1]:
            holder = holder[key]
        del holder[place[-1]]
        path.write_text(json.dumps(content))
        return False

    def deep(self) -> bool | None:
        path = self.pick(".json", ".jsonl")
        if path is None:
            return None
        opening, closing = self.random.choice((("[", "]"), ('{"a":', "}")))
        depth = self.random.choice((2000, 100_000, 1_000_000))
        closed = self.random.random() < 0.5
        path.write_text(opening * depth + ("1" + closing * depth if closed else "") + "\n")
        return True

    def digits(self) -> bool | None:
        path = self.pick(".json")
        if path is None:
            return None
        path.write_text('{"format": "koala-scene", "version": ' + "9" * 10_000 + "}")
        return True

    def pickled(self) -> bool | None:
        path = self.pick(".npy", ".npz")
        if path is None:
            return None
        trap = np.array([Trap(str(self.outside / "sprung"))], dtype=object)
        way = self.random.randrange(3)
        if way == 0:
            path.write_bytes(pickle.dumps(Trap(str(self.outside / "sprung"))))
        elif path.suffix == ".npy":
            np.save(path, trap, allow_pickle=True)
        else:
            with np.load(path) as stored:
                names = list(stored.files)
            np.savez(path, **{name: trap for name in names})
        return True

    def zip_bomb(self) -> bool | None:
        path = self.pick(".npz")
        if path is None:
            return None
        with np.load(path) as stored:
            names = list(stored.files)
        header = (
            b"\x93NUMPY\x01\x00v\x00" + b"{'descr': '<f8', 'fortran_order': False, 'shape': (100000000,), }".ljust(117) + b"\n"
        )
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name in names[:2]:
                with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                    file.write(header)
                    for _ in range(150):
                        file.write(b"\0" * 2**20)
        return True

    def huge_shape(self) -> bool | None:
        path = self.pick(".npy")
        if path is None:
            return None
        shape = self.random.choice(
            ("(1000000000000, 17)", "(-1, 17)", "(3, 17" + ", 99999" * 8 + ")", "(" * 300, "(17,) * 10**9")
        )
        header = ("{'descr': '<f8', 'fortran_order': False, 'shape': " + shape + ", }").encode().ljust(600) + b"\n"
        path.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + b"\0" * 1000)
        return True

    def words(self) -> bool | None:
        path = self.pick(".txt")
        if path is None:
            return None
        words = path.read_text().split(" ")
        bad = ("nan", "inf", "-1", "99999999999999999999", "x", "", "\x00", "1e999", "é" * 100)
        for _ in range(self.random.randint(1, 4)):
            words[self.random.randrange(len(words))] = self.random.choice(bad)
        path.write_text(" ".join(words))
        return False

    def garbage(self) -> bool:
        path = self.pick()
        path.write_bytes(self.random.randbytes(self.random.choice((0, 1, 7, 100, 10_000))))
        return False

    def folder_for_file(self) -> bool:
        path = self.pick()
        path.unlink()
        path.mkdir()
        return False


class Trap:
    """Leaves a file behind where it is unpickled."""

    def __init__(self, path: str) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return (os.mkdir, (self.path,))


def leaves(content: Any, place: tuple = ()) -> list[tuple]:
    """Places of all values that hold no others."""
    inner = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    found = [leaf for key, value in inner for leaf in leaves(value, (*place, key))]
    return found or ([place] if place else [])


def put(content: Any, place: tuple, value: Any) -> None:
    for key in place[:-1]:
        content = content[key]
    content[place[-1]] = value


def png_header(side: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 1000)) + chunk(b"IEND", b"")


def jpeg_header(side: int) -> bytes:
    side = min(side, 65500)
    tables = b"\xff\xdb\x00\x43\x00" + b"\x01" * 64
    return (
        b"\xff\xd8"
        + tables
        + b"\xff\xc0\x00\x11\x08"
        + struct.pack(">HH", side, side)
        + b"\x03\x01\x11\x00\x02\x11\x00\x03\x11\x00"
        + b"\xff\xda"
        + b"\0" * 200
    )


def tiff_header(side: int) -> bytes:
    entries = [(256, 4, 1, side), (257, 4, 1, side), (258, 3, 1, 8), (259, 3, 1, 1), (262, 3, 1, 1), (273, 4, 1, 200), (277, 3, 1, 1),
               (278, 4, 1, side), (279, 4, 1, 1000)]  # fmt: skip
    body = struct.pack("<H", len(entries)) + b"".join(struct.pack("<HHII", *entry) for entry in entries) + struct.pack("<I", 0)
    return (b"II*\0" + struct.pack("<I", 8) + body).ljust(1300, b"\0")


WAYS: tuple[str, ...] = (
    "truncate", "cut_table", "flip", "huge_number", "traverse_json", "traverse_table", "link_out", "link_round", "bomb", "bad_value",
    "bad_value", "nan_everywhere", "drop_key", "deep", "digits", "pickled", "zip_bomb", "huge_shape", "words", "garbage", "folder_for_file",
)  # fmt: skip
