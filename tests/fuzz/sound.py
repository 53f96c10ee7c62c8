"""Small sound inputs, one folder for each kind of thing that Koala reads from strangers."""

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import equinox as eqx
import numpy as np
import yaml

from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration, LinkErrors, UncertainPose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.formats import ply, save_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import Frame, Recording
from koala3d.datasets.scene import Scene, Sightings, View
from tests.fuzz import captured

PICTURES = (".png", ".jpg", ".tif", ".exr")
LAYOUTS = ("koala", "blender", "nerfstudio", "llff", "dtu", "colmap", "colmap-text")
CAMERA = Camera(24, 18, 30.0, 30.0, 12.0, 9.0)
BOARD = {
    "type": "charuco",
    "squares_x": 5,
    "squares_y": 4,
    "square_length_m": 0.03,
    "marker_length_m": 0.02,
    "dictionary": "DICT_4X4_50",
}
ROOT = Path(__file__).parent.parent.parent


class State(eqx.Module):
    """Stands for a training state: `reconstruct.checkpoint` takes any tree with a step."""

    step: Any
    weights: Any
    moments: Any


def sound_inputs(folder: Path) -> dict[str, Path]:
    """Folder of one small input of each kind."""
    scene = _scene(folder / "source")
    found = {}
    for layout in LAYOUTS:
        save_scene(scene, folder / layout, layout)
        found[layout] = folder / layout
        if layout not in ("koala", "blender"):
            shutil.copytree(folder / layout, folder / f"{layout}-bare")
            (folder / f"{layout}-bare" / "koala.json").unlink()
            found[f"{layout}-bare"] = folder / f"{layout}-bare"
    makers = captured.MAKERS | {
        "recording": _recording,
        "calibration": _calibration,
        "points": _points,
        "picture": _pictures,
        "trajectory": _trajectory,
        "rig": _rig,
        "path": _path,
        "session": _session,
        "run": _run,
        "mesh": _meshes,
        "video": _video,
    }
    for kind, make in makers.items():
        (folder / kind).mkdir()
        make(folder / kind)
        found[kind] = folder / kind
    return found


def _scene(folder: Path) -> Scene:
    generator, views = np.random.default_rng(0), []
    for index, suffix in enumerate(PICTURES):
        matrix = pose.look_at((np.cos(index), np.sin(index), 0.5), (0, 0, 0))
        path, mask, depth = (folder / f"{index}{end}" for end in (suffix, "_mask.png", "_depth.exr"))
        images.write(path, generator.random((18, 24, 3)).astype(np.float32))
        images.write(mask, np.uint8(255 * (generator.random((18, 24)) > 0.3)))
        images.write(depth, np.full((18, 24, 1), 1.0, np.float32))
        views.append(View(f"{index}", CAMERA, matrix, ("train", "test")[index % 2], path, mask, {"depth": depth}))
    index = np.array([[0, 0], [0, 1], [1, 2], [2, 3]])
    seen = Sightings(tuple(view.name for view in views), index, np.full((4, 2), 5.0))
    box = np.array([[-1.0, -1, -1], [1, 1, 1]])
    points = generator.normal(size=(3, 3))
    return Scene(
        "fuzzed", tuple(views), 0.1, np.inf, box, "white", points=points, colours=np.zeros((3, 3), np.uint8), sightings=seen
    )


def _recording(folder: Path) -> None:
    trajectory = yaml.safe_load((ROOT / "configs" / "trajectories" / "koala_demo.yaml").read_text())
    region = {"width": 24, "height": 18, "offset_x": 0, "offset_y": 0, "binning": 1}
    volume = {"centre": [0.0, 0.0, 0.0], "size": [0.2, 0.2, 0.2]}
    recording = Recording.create(folder, {"trajectory": trajectory, "camera": {"region": region}, "object": volume})
    generator = np.random.default_rng(1)
    for number in range(3):
        name = f"{number:03d}"
        path = folder / "images" / f"{name}.png"
        images.write(path, generator.random((18, 24, 3)).astype(np.float32))
        images.write(folder / "truth" / "depth" / f"{name}.exr", np.full((18, 24, 1), 1.0, np.float32))
        matrix = pose.look_at((np.cos(number), np.sin(number), 0.5), (0, 0, 0))
        recording.append(
            Frame(
                index=number,
                name=name,
                split="train",
                image=f"images/{name}.png",
                base_from_flange=matrix,
                joints=np.zeros(6),
                robot_time_s=0.1 * number,
                host_time_ns=number,
                device_ticks=number,
                exposure_us=1e4,
                settle_s=0.1,
                sha256=files.sha256(path),
            )
        )
    ply.write_points(folder / "truth" / "object.ply", np.zeros((3, 3)))
    _calibration(folder)


def _calibration(folder: Path) -> None:
    mount = UncertainPose(np.eye(4), 1e-6 * np.eye(6))
    errors = LinkErrors(np.zeros(24), np.zeros(24))
    Calibration(CAMERA, {"fx": 1.0}, mount, mount, link_errors=errors).save(folder / "calibration.json")


def _points(folder: Path) -> None:
    points = np.random.default_rng(2).normal(size=(20, 3))
    ply.write_points(folder / "little.ply", points)
    rows = "".join(f"{x} {y} {z} 1 2 3\n" for x, y, z in points)
    properties = "".join(f"property float {axis}\n" for axis in "xyz") + "".join(
        f"property uchar {c}\n" for c in ("red", "green", "blue")
    )
    header = f"ply\nformat ascii 1.0\ncomment made for a test\nelement vertex 20\n{properties}end_header\n"
    (folder / "text.ply").write_text(header + rows)


def _pictures(folder: Path) -> None:
    generator = np.random.default_rng(3)
    for suffix in PICTURES:
        images.write(folder / f"colour{suffix}", generator.random((18, 24, 3)).astype(np.float32), metadata={"Make": "nobody"})
    images.write(folder / "deep.png", generator.integers(0, 65535, (18, 24, 4)).astype(np.uint16))
    images.write(folder / "grey.tif", generator.integers(0, 255, (18, 24)).astype(np.uint8))


def _trajectory(folder: Path) -> None:
    for name in ("koala_demo", "calibration_demo"):
        shutil.copy(ROOT / "configs" / "trajectories" / f"{name}.yaml", folder)


def _rig(folder: Path) -> None:
    shutil.copy(ROOT / "configs" / "rigs" / "ur5e_basler.yaml", folder)


def _path(folder: Path) -> None:
    poses = [{"position": [x, 0.2, 0.4], "target": [0.4, 0.0, 0.15]} for x in (0.0, 0.3, 0.6)]
    (folder / "path.yaml").write_text(yaml.safe_dump({"fps": 5, "seconds": 2, "poses": poses}))


def _session(folder: Path) -> None:
    """Images of a board with poses in one file of all (CSV, lines, an array) and in one of each (YAML, JSON, OpenCV's)."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    picture = cv2.aruco.CharucoBoard((5, 4), 0.03, 0.02, dictionary).generateImage((100, 80), marginSize=8)
    numbers = [[0.1 * i, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0] for i in range(3)]
    for index, values in enumerate(numbers):
        images.write(folder / "images" / f"{index}.png", picture)
        (folder / f"pose-{index}.yaml").write_text(yaml.safe_dump({"data": values}))
        (folder / f"pose-{index}.json").write_text(json.dumps({"data": values}))
        for suffix in ("yml", "xml"):
            storage = cv2.FileStorage(str(folder / f"pose-{index}.{suffix}"), cv2.FILE_STORAGE_WRITE)
            storage.write("data", np.array([values]))
            storage.release()
    with open(folder / "poses.csv", "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["image", *"x y z qw qx qy qz".split()])
        table.writerows([f"{index}.png", *values] for index, values in enumerate(numbers))
    np.savetxt(folder / "poses.txt", [[index, *values] for index, values in enumerate(numbers)])
    np.save(folder / "poses.npy", numbers)
    base = {"images": "images/*.png", "layout": "x y z qw qx qy qz", "board": BOARD}
    for suffix in ("csv", "txt", "npy", "yaml", "json", "yml", "xml"):
        one = suffix in ("csv", "txt", "npy")
        content = {**base, "poses": f"poses.{suffix}" if one else f"pose-*.{suffix}", "key": "" if one else "data"}
        name = "import" if suffix == "csv" else f"by_{suffix}"
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(content))


def _video(folder: Path) -> None:
    """Four frames of noise."""
    import av

    random = np.random.default_rng(3)
    with av.open(str(folder / "walk.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for _ in range(4):
            frame = av.VideoFrame.from_ndarray(random.integers(0, 255, (48, 64, 3), dtype=np.uint8), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def _meshes(folder: Path) -> None:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.visual = trimesh.visual.ColorVisuals(ball, vertex_colors=np.full((len(ball.vertices), 4), 200, np.uint8))
    for suffix in (".ply", ".glb", ".obj", ".stl"):
        ball.export(folder / f"ball{suffix}")
    ball.export(folder / "text.ply", encoding="ascii")


def _run(folder: Path) -> None:
    """A run with two checkpoints. Its state is small; only how it is stored matters here."""
    from koala3d.reconstruct import checkpoint
    from koala3d.reconstruct.config import Config
    from koala3d.reconstruct.run import Run
    from koala3d.reconstruct.scene.facts import SceneFacts
    from koala3d.reconstruct.scene.rays import Normalisation

    shutil.rmtree(folder)
    normalisation = Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.1, 2.0)
    run = Run.create(folder, Config(), folder / "scene", SceneFacts(normalisation), {"budget_s": None})
    state = example_state()
    for step in (1, 2):
        checkpoint.save(run.path / "checkpoints", replace(state, step=np.int32(step)), {"seconds": float(step), "step": step})
        run.append_log({"step": step, "seconds": float(step), "progress": 0.5 * step})


def example_state() -> State:
    """A state as the run's checkpoints hold it."""
    generator = np.random.default_rng(4)
    return State(np.int32(0), generator.normal(size=(16, 8)).astype(np.float32), generator.normal(size=(40,)).astype(np.float32))
