"""Corrupted inputs, each from its number alone, and what becomes of them; run as a program by `test_fuzz.py`.

    python program.py FOLDER FIRST LAST STEP

makes a small sound input of every kind in FOLDER, corrupts a copy of one of them for every number of the range, reads it
completely, and prints one JSON object per number. A crash of the interpreter ends the output, so nothing can hide.
"""

import json
import random
import resource
import shutil
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from corruption import PICTURES, WAYS, Corruption
from watch import Watch, forget_peak, peak_bytes

from datasets import pose
from datasets.calibration import Calibration, UncertainPose
from datasets.camera_model import Camera
from datasets.checks.check import check
from datasets.core.errors import KoalaError
from datasets.formats import load_scene, save_scene
from datasets.imaging import images
from datasets.recording import Frame, Recording
from datasets.scene import Scene, Sightings, View

LAYOUTS = ("koala", "blender", "nerfstudio", "llff", "dtu", "colmap", "colmap-text")


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
    before, start = forget_peak(), time.process_time()
    outcome, message = "read", ""
    try:
        try:
            read_all(kind, folder)
        except KoalaError as error:
            outcome, message = "refused", str(error)
        if kind not in ("recording", "calibration"):
            found = check(folder, format=kind.removesuffix("-bare").removesuffix("-text"))
            if outcome == "refused" and not any(finding.level == "error" for finding in found):
                outcome, message = "escaped", f"check says nothing of: {message}"
    except BaseException as error:
        outcome, message = "escaped", f"{type(error).__name__}: {error}"
    return {"number": number, "kind": kind, "way": way, "must_fail": bool(must_fail), "outcome": outcome, "message": message[:400],
            "lines": len(message.splitlines()), "seconds": time.process_time() - start, "bytes": peak_bytes() - before,
            "opened": watch.opened(), "events": [*watch.events, *(["trap"] if (watch.folder / "sprung").exists() else [])]}  # fmt: skip


def main(folder: Path, numbers: range) -> None:
    sources = sound_inputs(folder / "sound")
    outside = folder / "work" / "outside"
    outside.mkdir(parents=True)
    shutil.copy(folder / "sound" / "source" / "0.png", outside / "secret.png")
    for kind, path in sources.items():
        read_all(kind, path)  # the premise; and all modules are loaded now
    check(sources["koala"])
    resource.setrlimit(resource.RLIMIT_AS, (8 * 2**30, 8 * 2**30))  # the machine is not to suffer where a limit is missed
    watch = Watch(outside)
    images.read(outside / "secret.png")
    assert watch.opened()  # the premise: what a library of C++ opens is seen, too
    for number in numbers:
        print(json.dumps(attempt(number, sources, folder / "work", watch)), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), range(*map(int, sys.argv[2:5])))
