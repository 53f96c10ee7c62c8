"""Time and memory of commands on many large photographs: the fox, enlarged, with masks of an ellipsoid as files or as alpha."""

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.files import write_json
from koala3d.datasets.formats import load_scene
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.structure import bounds

AXES = np.array([1.0, 0.8, 1.2])
"""Half axes of the ellipsoid about the point that the cameras look at [world unit]."""
NOISE = 2.0
"""Standard deviation [steps of 255]: without noise, enlarged pictures would be decoded faster than photographs are."""
KINDS = ("masks", "alpha")
"""JPEG with PNG masks; PNG with the mask as alpha."""
COMMANDS = {
    "info": ["info", "{scene}"],
    "again": ["info", "{scene}"],
    "check": ["check", "{scene}"],
    "undistort": ["edit", "{scene}", "--undistort", "--out", "{out}"],
}
"""Arguments of `datasets`; all of them share a cache that is empty at first."""


def write(scene: Scene, folder: Path, *, count: int, width: int, height: int) -> None:
    """Write a scene of `count` views for each of `KINDS`; files of views beyond those of `scene` are links to the first."""
    cameras = [_enlarged(view.camera, width, height) for view in scene.views]
    for kind in KINDS:
        frames = []
        for number in range(count):
            view, camera = scene.views[number % len(cameras)], cameras[number % len(cameras)]
            image, mask = _files(folder / kind, kind, number)
            if number < len(cameras):
                _draw(scene, view, camera, image, mask)
            else:
                for path, first in zip((image, mask), _files(folder / kind, kind, number % len(cameras)), strict=True):
                    if first is not None and path is not None:
                        os.link(first, path)
            gl_from_camera = view.world_from_camera @ np.diag([1.0, -1.0, -1.0, 1.0])
            frames.append({"file_path": f"images/{image.name}", "transform_matrix": gl_from_camera.tolist()})
            frames[-1] |= {} if mask is None else {"mask_path": f"masks/{mask.name}"}
        one = cameras[0]
        lens = {
            "fl_x": one.fx,
            "fl_y": one.fy,
            "cx": one.cx,
            "cy": one.cy,
            "k1": one.k1,
            "k2": one.k2,
            "p1": one.p1,
            "p2": one.p2,
        }
        write_json(folder / kind / "transforms.json", {"w": width, "h": height, **lens, "frames": frames})


def _files(folder: Path, kind: str, number: int) -> tuple[Path, Path | None]:
    """Image and mask of a view."""
    for name in ("images", "masks") if kind == "masks" else ("images",):
        (folder / name).mkdir(parents=True, exist_ok=True)
    if kind == "alpha":
        return folder / "images" / f"{number:04}.png", None
    return folder / "images" / f"{number:04}.jpg", folder / "masks" / f"{number:04}.png"


def _enlarged(camera: Camera, width: int, height: int) -> Camera:
    """The camera of the middle of a picture that is scaled to `width`."""
    tall = round(camera.height * width / camera.width)
    scaled = camera.scaled(width, tall)
    return replace(scaled, height=height, cy=scaled.cy - (tall - height) // 2)


def _draw(scene: Scene, view: View, camera: Camera, image: Path, mask: Path | None) -> None:
    pixels = cv2.imread(str(view.image))
    assert pixels is not None, "the scene was read"
    tall = round(view.camera.height * camera.width / view.camera.width)
    top = (tall - camera.height) // 2
    large = cv2.resize(pixels, (camera.width, tall), interpolation=cv2.INTER_CUBIC)[top : top + camera.height]
    noise = np.empty(large.shape, np.int16)
    cv2.setRNGSeed(1)
    cv2.randn(noise, 0, NOISE)  # type: ignore[call-overload]
    noisy = np.clip(large + noise, 0, 255).astype(np.uint8)
    outline = _outline(scene, view, camera)
    if mask is None:
        cv2.imwrite(str(image), np.dstack([noisy, outline]), [cv2.IMWRITE_PNG_COMPRESSION, 3])
    else:
        cv2.imwrite(str(image), noisy, [cv2.IMWRITE_JPEG_QUALITY, 92])
        cv2.imwrite(str(mask), outline, [cv2.IMWRITE_PNG_COMPRESSION, 3])


def _outline(scene: Scene, view: View, camera: Camera) -> NDArray[np.uint8]:
    """(height, width) mask of the ellipsoid."""
    centre, _ = bounds.focus(np.stack([one.world_from_camera for one in scene.views]))
    surface = np.random.default_rng(0).normal(size=(20_000, 3))
    points = centre + AXES * surface / np.linalg.norm(surface, axis=1, keepdims=True)
    local = (points - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
    hull = cv2.convexHull(camera.project(local).astype(np.float32))
    mask = np.zeros((camera.height, camera.width), np.uint8)
    return np.asarray(cv2.fillConvexPoly(mask, np.rint(16 * hull).astype(np.int32), 255, cv2.LINE_AA, 4), np.uint8)


def measured(arguments: list[str], cache: Path) -> dict[str, Any]:
    """Seconds of wall time and of all cores, and largest memory [GB] of a command in a process of its own."""
    program = [sys.executable, "-c", "from koala3d.datasets.cli import main; main()", *arguments]
    begun = time.perf_counter()
    process = subprocess.Popen(program, env={**os.environ, "KOALA_CACHE": str(cache)}, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    seconds, cpu = time.perf_counter() - begun, used.ru_utime + used.ru_stime
    return {"status": os.waitstatus_to_exitcode(status), "seconds": seconds, "cpu_seconds": cpu, "gb": used.ru_maxrss / 2**20}


def main(
    folder: Annotated[Path, typer.Argument(help="Where the pictures are; they are written if it is missing.")],
    source: Annotated[Path, typer.Option(help="The fox.")] = Path("../shared/data/fox"),
    command: Annotated[list[str] | None, typer.Option(help=f"Some of {', '.join(COMMANDS)}; all if not given.")] = None,
    kind: Annotated[list[str] | None, typer.Option(help=f"Some of {', '.join(KINDS)}.")] = None,
    count: Annotated[int, typer.Option(help="Number of photographs.", min=1)] = 300,
) -> None:
    """Measure what commands take for many photographs of 24 megapixels."""
    if not folder.exists():
        write(load_scene(source), folder, count=count, width=4000, height=6000)
    with tempfile.TemporaryDirectory() as work:
        for one in kind or KINDS:
            for name in command or COMMANDS:
                named = {"scene": folder / one, "out": Path(work) / one}
                found = measured([part.format(**named) for part in COMMANDS[name]], Path(work) / f"cache_{one}")
                print(json.dumps({"kind": one, "command": name, **found}), flush=True)


if __name__ == "__main__":
    typer.run(main)
