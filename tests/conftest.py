"""Shared by the tests of every package: real data where it exists, small synthetic scenes, and the browser of `tests.browser`."""

import io
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import Frame, Recording
from koala3d.datasets.scene import Scene, View
from tests.browser import browse as browse
from tests.browser import chromium as chromium
from tests.clients import client as client
from tests.clients import pytest_pycollect_makeitem as pytest_pycollect_makeitem
from tests.cost import Cost
from tests.required import ALL_REQUIRED, Required

ROOT = Path(__file__).parent.parent
SHARED = ROOT.parent / "shared" / "data"

USERS_CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
CACHE = Path(os.environ.setdefault("KOALA_CACHE", str(USERS_CACHE / "koala-tests")))
"""Cache of this suite only: compiled programs are shared between tests, workers and clones. They are found by their content."""
os.environ["JAX_COMPILATION_CACHE_DIR"] = str(CACHE / "jax")
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
os.environ.setdefault("KOALA_RENDERER", "scalar_rgb")
"""One variant of Mitsuba for the whole suite: two of them in one process end it."""

_NUMERICS = (
    "numerics",
    "scene.rays",
    "field",
    "sampling",
    "rendering.model",
    "surface",
    "training.losses",
    "training.objective",
    "training.schedules",
)
install_import_hook(
    [f"koala3d.reconstruct.{name}" for name in _NUMERICS], "beartype.beartype"
)  # shapes as annotated, or an error

settings.register_profile("quick", max_examples=10, deadline=None)
settings.register_profile("thorough", max_examples=60, deadline=None)
settings.load_profile("quick")  # `make test-all` takes the other

LONG = (
    "tests/reconstruct/training/test_every_model.py",
    "tests/test_pipeline.py",
    "tests/reconstruct/experiments/test_sweep_on_ray.py",
    "tests/reconstruct/series/test_whole_series.py",
    "tests/reconstruct/training/test_quality.py",
    "tests/faults/test_faults.py",
    "tests/reconstruct/training/test_distributed.py",
    "tests/reconstruct/training/test_step.py",
    "tests/view/test_pages.py",
    "tests/docs/test_references.py",
)
"""The slowest files run first, so that no worker is left with one at the end. The first compiles what others find again."""

LENS = Camera(96, 72, 90.0, 91.0, 50.3, 34.1, k1=-0.12, k2=0.05, p1=1e-3, p2=-8e-4, k3=0.01)
"""A real-looking lens: barrel distortion, off-centre, pixels not quite square."""
PINHOLE = Camera(96, 72, 90.0, 90.0, 48.0, 36.0)


def pytest_configure(config: pytest.Config) -> None:
    """Measure what the suite costs, and with KOALA_REQUIRE=all count skips as failures."""
    config.pluginmanager.register(Cost())
    if ALL_REQUIRED:
        config.pluginmanager.register(Required())


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Order tests by file, `LONG` first."""
    ranks = {ROOT / name: rank for rank, name in enumerate(LONG)}
    items.sort(key=lambda item: ranks.get(item.path, len(LONG)))


@pytest.fixture(scope="session")
def run_inside() -> Callable[..., "subprocess.CompletedProcess[str]"]:
    """Runs a command by its `main`, name and arguments inside this process; returns what `subprocess.run` does."""

    def run(main: Callable[[], None], *words: object) -> "subprocess.CompletedProcess[str]":
        argv, out, err = [*map(str, words)], io.StringIO(), io.StringIO()
        with mock.patch.object(sys, "argv", argv), redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as left:
            main()
        return subprocess.CompletedProcess(argv, int(left.value.code or 0), out.getvalue(), err.getvalue())

    return run


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """SIGINT interrupts this process, also if the tests were started with the signal ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def real_data() -> Callable[[str], Path]:
    """Folder of a real data set by name; skips the test where it is absent."""

    def folder(name: str) -> Path:
        if not (SHARED / name).exists():
            pytest.skip(f"real data set {name} is absent: {SHARED / name} does not exist")
        return SHARED / name

    return folder


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 2 MB."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(place)], capture_output=True, check=False)
    if mounted.returncode:
        pytest.skip("a small disk cannot be made: mounting a tmpfs needs root")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


def texture(points: np.ndarray) -> np.ndarray:
    """(..., 3) smooth colours of (..., 3) directions: the texture of a far wall, so that any resampling has an exact result."""
    x, y, z = np.moveaxis(points / np.linalg.norm(points, axis=-1, keepdims=True), -1, 0)
    return np.stack([0.5 + 0.3 * np.sin(9 * x + 2 * z), 0.5 + 0.3 * np.cos(8 * y - x), 0.5 + 0.3 * np.sin(7 * x * y + 5 * z)], -1)


@pytest.fixture
def far_wall() -> Callable[[Camera, np.ndarray], np.ndarray]:
    """Exact (height, width, 3) picture of the `texture` at infinity, from a camera and its world_from_camera."""

    def picture(camera: Camera, world_from_camera: np.ndarray) -> np.ndarray:
        return texture(camera.directions(camera.pixel_centres()) @ world_from_camera[:3, :3].T)

    return picture


@pytest.fixture
def make_scene(tmp_path: Path, far_wall: Callable[[Camera, np.ndarray], np.ndarray]) -> Callable[..., Scene]:
    """Factory of small scenes with images and truth on disk: cameras on a ring that look at the origin."""

    def make(camera: Camera = PINHOLE, count: int = 9, *, truth: bool = True, mask: bool = False) -> Scene:
        folder = tmp_path / "source"
        views = []
        for index in range(count):
            angle, name = 2 * np.pi * index / count, f"{index:03d}"
            matrix = pose.look_at((0.4 * np.cos(angle), 0.4 * np.sin(angle), 0.2 + 0.02 * index), (0, 0, 0))
            images.write(folder / f"{name}.png", far_wall(camera, matrix))
            maps = {}
            if truth and index % 4 == 0:
                size = (camera.height, camera.width)
                normal = np.broadcast_to(matrix[:3, 2] * -1, (*size, 3))
                for key, values in {"normals": normal, "depth": np.full((*size, 1), 0.4), "alpha": np.ones((*size, 1))}.items():
                    maps[key] = folder / f"{name}_{key}.exr"
                    images.write(maps[key], values.astype(np.float32))
            masked = None
            if mask:
                masked = folder / f"{name}_mask.png"
                columns, rows = np.moveaxis(camera.pixel_centres(), -1, 0)
                disc = np.hypot(columns - camera.cx, rows - camera.cy) < 20
                images.write(masked, np.uint8(disc * 255))
            split = "test" if index % 4 == 0 else "train"
            views.append(View(name, camera, matrix, split, folder / f"{name}.png", masked, maps))
        box = np.array([[-0.1, -0.1, -0.1], [0.1, 0.1, 0.12]])
        background = "white" if mask else "scene"
        return Scene("little", tuple(views), 0.1, np.inf, box, background, metric=True, provenance={"made": "for a test"})

    return make


@pytest.fixture
def simulated_session() -> Callable[..., Path]:
    """Factory of recordings of three frames with their truth, in which the true mount is near identity."""

    def make(path: Path, *, hand_eye_shift_mm: float = 0.0, hand_eye_turn_deg: float = 0.0, arm_shift_mm: float = 0.0) -> Path:
        recording = Recording.create(path, {"trajectory": {}})
        mount = pose.from_rotation_vector([0, 0, np.deg2rad(hand_eye_turn_deg)], [1e-3 * hand_eye_shift_mm, 0, 0])
        true_cameras = {}
        for index in range(3):
            reported = pose.from_rotation_vector([0, 0, 0], [0.4, 0.1 * index, 0.3])
            name = f"{index:03d}"
            true_cameras[name] = (pose.rigid(np.eye(3), [0, 1e-3 * arm_shift_mm, 0]) @ reported @ mount).tolist()
            recording.append(
                Frame(
                    index=index,
                    name=name,
                    split="calibration",
                    image=f"images/{name}.png",
                    base_from_flange=reported,
                    joints=np.zeros(6),
                    robot_time_s=0.0,
                    host_time_ns=0,
                    device_ticks=0,
                    exposure_us=1e4,
                    settle_s=0.1,
                    sha256="",
                )
            )
        files.write_json(
            path / "truth" / "poses.json",
            {
                "format": "koala-truth",
                "version": 1,
                "camera": PINHOLE.to_json(),
                "flange_from_camera": mount.tolist(),
                "base_from_camera": true_cameras,
            },
        )
        return path

    return make
