"""Corrupted inputs, each from its number alone, and what becomes of them; run as a program by `test_fuzz.py`.

    python fuzzing.py FOLDER FIRST LAST STEP

makes a small sound input of every kind in FOLDER, corrupts a copy of one of them for every number of the range, reads it
completely, and prints one JSON object per number. A crash of the interpreter ends the output, so nothing can hide.
"""

import ctypes
import ctypes.util
import json
import os
import pickle
import random
import resource
import shutil
import struct
import sys
import time
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from datasets import images, pose
from datasets.calibration import Calibration, UncertainPose
from datasets.camera_model import Camera
from datasets.errors import KoalaError
from datasets.formats import load_scene, save_scene
from datasets.recording import Frame, Recording
from datasets.scene import Scene, Sightings, View

LAYOUTS = ("koala", "blender", "nerfstudio", "llff", "dtu", "colmap", "colmap-text")
PICTURES = (".png", ".jpg", ".tif", ".exr")
WATCHED = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork", "pickle.find_class", "ctypes.dlopen")
events: list[str] = []


def sound_inputs(folder: Path) -> dict[str, Path]:
    """One small input of each kind."""
    generator = np.random.default_rng(0)
    camera = Camera(24, 18, 30.0, 30.0, 12.0, 9.0)
    views = []
    for index, suffix in enumerate(PICTURES):
        matrix = pose.look_at((np.cos(index), np.sin(index), 0.5), (0, 0, 0))
        path, mask, depth = (folder / "source" / f"{index}{end}" for end in (suffix, "_mask.png", "_depth.exr"))
        images.write(path, generator.random((18, 24, 3)).astype(np.float32))
        images.write(mask, np.uint8(255 * (generator.random((18, 24)) > 0.3)))
        images.write(depth, np.full((18, 24, 1), 1.0, np.float32))
        views.append(View(f"{index}", camera, matrix, ("train", "test")[index % 2], path, mask, {"depth": depth}))
    index = np.array([[0, 0], [0, 1], [1, 2], [2, 3]])
    seen = Sightings(tuple(v.name for v in views), index, np.full((4, 2), 5.0), np.zeros((3, 3), np.uint8))
    scene = Scene("fuzzed", tuple(views), 0.1, np.inf, np.array([[-1.0, -1, -1], [1, 1, 1]]), "white",
                  points=generator.normal(size=(3, 3)), sightings=seen)  # fmt: skip
    found = {}
    for layout in LAYOUTS:
        save_scene(scene, folder / layout, layout)
        found[layout] = folder / layout
        if layout not in ("koala", "blender"):
            shutil.copytree(folder / layout, folder / f"{layout}-bare")
            (folder / f"{layout}-bare" / "koala.json").unlink()
            found[f"{layout}-bare"] = folder / f"{layout}-bare"
    recording = Recording.create(folder / "recording", {"trajectory": {}})
    for number in range(3):
        recording.append(
            Frame(number, f"{number}", "train", f"images/{number}.png", np.eye(4), np.zeros(6), 0.0, 0, 0, 1e4, 0.1, "")
        )
    found["recording"] = folder / "recording"
    (folder / "calibration").mkdir()
    Calibration(camera, {}, UncertainPose(np.eye(4), np.eye(6))).save(folder / "calibration" / "calibration.json")
    found["calibration"] = folder / "calibration"
    return found


def read_all(kind: str, folder: Path) -> None:
    """Read everything that an input holds."""
    if kind == "recording":
        assert Recording.open(folder).frames is not None
    elif kind == "calibration":
        Calibration.load(folder / "calibration.json")
    else:
        scene = load_scene(folder, format=kind.removesuffix("-bare").removesuffix("-text"))
        for view in scene.views:
            assert view.read().shape[:2] == (view.camera.height, view.camera.width)
            for channel in view.truth:
                view.read_truth(channel)
        assert np.isfinite(scene.box).all() and scene.near < scene.far
        assert all(np.isfinite(view.world_from_camera).all() for view in scene.views)


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


class Watch:
    """Tells of every file below a folder that anybody opens, C++ libraries included (inotify)."""

    def __init__(self, folder: Path) -> None:
        self.library = ctypes.CDLL(ctypes.util.find_library("c"), use_errno=True)
        self.descriptor = self.library.inotify_init1(os.O_NONBLOCK)
        self.folder = folder
        self.refresh()

    def refresh(self) -> None:
        """Watch all folders below, also new ones; what happened so far is forgotten."""
        for path in (self.folder, *(p for p in self.folder.rglob("*") if p.is_dir())):
            self.library.inotify_add_watch(self.descriptor, os.fsencode(path), 0x20)  # IN_OPEN
        self.opened()

    def opened(self) -> list[str]:
        """Names of files that were opened since the last call; listing a folder is no opening of a file."""
        names = []
        try:
            data = os.read(self.descriptor, 2**20)
        except BlockingIOError:
            return names
        at = 0
        while at < len(data):
            _, mask, _, length = struct.unpack_from("iIII", data, at)
            name = data[at + 16 : at + 16 + length].rstrip(b"\0").decode()
            at += 16 + length
            if name and not mask & 0x40000000:  # IN_ISDIR
                names.append(name)
        return names


def peak_bytes() -> int:
    """Most resident memory since `forget_peak`."""
    return next(
        int(line.split()[1]) * 1024 for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM")
    )


def forget_peak() -> int:
    """Start anew; returns the memory in use."""
    Path("/proc/self/clear_refs").write_text("5")
    return peak_bytes()


def attempt(number: int, sources: dict[str, Path], work: Path, watch: Watch) -> dict[str, Any]:
    """Corrupt the input of one number and read it."""
    source = random.Random(number)
    for _ in range(1000):
        kind, way = source.choice(sorted(sources)), source.choice(WAYS)
        folder = work / "scenes" / "input"
        shutil.rmtree(folder.parent, ignore_errors=True)
        shutil.copytree(sources[kind], folder)
        must_fail = getattr(Corruption(folder, watch.folder, number), way)()
        if must_fail is not None:
            break
    watch.refresh()
    events.clear()
    before, start = forget_peak(), time.process_time()
    outcome, message = "read", ""
    try:
        read_all(kind, folder)
    except KoalaError as error:
        outcome, message = "refused", str(error)
    except BaseException as error:
        outcome, message = "escaped", f"{type(error).__name__}: {error}"
    return {"number": number, "kind": kind, "way": way, "must_fail": bool(must_fail), "outcome": outcome, "message": message[:400],
            "lines": len(message.splitlines()), "seconds": time.process_time() - start, "bytes": peak_bytes() - before,
            "opened": watch.opened(), "events": [*events, *(["trap"] if (watch.folder / "sprung").exists() else [])]}  # fmt: skip


def main(folder: Path, numbers: range) -> None:
    sources = sound_inputs(folder / "sound")
    outside = folder / "work" / "outside"
    outside.mkdir(parents=True)
    shutil.copy(folder / "sound" / "source" / "0.png", outside / "secret.png")
    for kind, path in sources.items():
        read_all(kind, path)  # the premise; and all modules are loaded now
    resource.setrlimit(resource.RLIMIT_AS, (8 * 2**30, 8 * 2**30))  # the machine is not to suffer where a limit is missed
    sys.addaudithook(lambda event, arguments: events.append(event) if event in WATCHED else None)
    watch = Watch(outside)
    for number in numbers:
        print(json.dumps(attempt(number, sources, folder / "work", watch)), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), range(*map(int, sys.argv[2:5])))
