"""The simulated camera: renders what the lens sees from the true pose of the arm, and delivers it through a vendor's emulation.

The driver is therefore the one for real cameras; only the light is computed.
"""

import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import SimulationError
from koala3d.capture.drivers.measurements import Image
from koala3d.capture.model.device import Device
from koala3d.capture.model.flaws import Flaws, SensorMaps, lamp_light
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.sim.emulated import camera_from_depth, emulated
from koala3d.capture.sim.laboratory.lens import Lens, Sensor
from koala3d.capture.sim.laboratory.views import make_view
from koala3d.capture.sim.truth import RigTruth, seed_of_camera
from koala3d.capture.sim.turntable import SimulatedTurntable
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import UPRIGHT

MOMENTS = 16  # number of moments of an exposure at which the pose of the arm is sampled
SHARP_PX = 0.05  # smaller motion during an exposure is not rendered [px]
NEAR_M = 0.3  # distance of the closest things, which move fastest through the picture [m]
SUFFIXES = {"normals": ".exr", "depth": ".exr", "alpha": ".png", "diffuse": ".exr", "specular": ".exr"}
LIGHT = ("diffuse", "specular")
RAW_BITS = {"rgb8": 0, "bayer8": 8, "bayer12": 12, "mono8": 8, "mono12": 12}
"""Bits of a raw value, by `camera.pixel_format`; 0: the camera sends colours."""
GREY = np.array([[0.2126], [0.7152], [0.0722]], np.float32)
"""What a grey sensor makes of red, green and blue light: luminance (ITU-R BT.709)."""


PERFECT = Flaws()


class TrueArm(Protocol):
    """What the camera needs from the simulated arm."""

    def exposed(self, exposure_s: float, count: int) -> NDArray[np.float64]:
        """(count, 4, 4) true flange poses during an exposure that starts now [m]."""
        ...

    def signals(self) -> dict[str, Any]:
        """The electrical outputs of its controller, by the side channel's `signals`; asked only where they switch lamps."""
        ...


class StillArm:
    """An arm that stands still at one flange pose."""

    def __init__(self, base_from_flange: NDArray[np.float64]) -> None:
        self.base_from_flange = base_from_flange

    def exposed(self, exposure_s: float, count: int) -> NDArray[np.float64]:
        """See `TrueArm`."""
        return np.stack([self.base_from_flange] * count)

    def signals(self) -> dict[str, Any]:
        """See `TrueArm`; nothing is on."""
        return {"digital": 0}


def blur_moments(camera: Camera, base_from_camera: NDArray[np.float64]) -> NDArray[np.int64]:
    """Indices of the (n, 4, 4) camera poses of an exposure whose pictures are averaged.

    One for a camera at rest; for a moving camera enough for steps of half a pixel.
    """
    edges = np.array([[0, 0], [camera.width, 0], [0, camera.height], [camera.width, camera.height], [camera.cx, camera.cy]])
    points = camera.directions(edges.astype(np.float64)) * NEAR_M
    first_from_camera = pose.inverse(base_from_camera[0]) @ base_from_camera
    seen = points @ np.swapaxes(first_from_camera[:, :3, :3], -1, -2) + first_from_camera[:, None, :3, 3]
    moved = (seen[..., :2] / seen[..., 2:] - points[:, :2] / NEAR_M) * [camera.fx, camera.fy]
    span = float(np.linalg.norm(moved.max(axis=0) - moved.min(axis=0), axis=-1).max())
    if span < SHARP_PX:
        return np.zeros(1, np.int64)
    count = min(max(int(np.ceil(2 * span)), 3), len(base_from_camera))
    return np.rint(np.linspace(0, len(base_from_camera) - 1, count)).astype(np.int64)


class SimulatedCamera:
    """A camera whose light is computed; implements `capture.drivers.protocols.Camera` and `GroundTruth`.

    Args:
        trajectory: camera settings, and positions of object, board and table.
        scene: a name from `capture.sim.laboratory.scenes.SCENES`.
        truth: the true camera and mount.
        arm: gives the true flange poses.
        seed: of textures, and with `number` of flaws and noise. Noise also depends on the frame number, but not on earlier
            pictures.
        flaws: of sensor, lens and lamps.
        device: the camera of the rig.
        table: what turns the object before still lamps; None: it stands.
        number: which of the rig's cameras it is, from 0; each has flaws and noise of its own.
        pose: name of the way in which the object lies.
        lamps: digital outputs of the arm's controller that switch the lamps of the laboratory; empty: it is lit evenly.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        scene: str,
        truth: RigTruth,
        arm: TrueArm,
        seed: int,
        flaws: Flaws = PERFECT,
        *,
        device: Device | None = None,
        table: SimulatedTurntable | None = None,
        number: int = 0,
        pose: str = UPRIGHT,
        lamps: tuple[int, ...] = (),
    ) -> None:
        self.lamps = lamps
        board = truth.beside.flange_from_board if truth.beside is not None else None
        self.view = make_view(scene, trajectory, seed, board, pose=pose)
        self.trajectory, self.truth, self.seed = trajectory, truth, seed_of_camera(seed, number)
        self._arm, self._frame, self._table = arm, 0, table
        self._world_from_camera: NDArray[np.float64] | None = None
        self._base_from_object: NDArray[np.float64] = np.eye(4)
        device = device or Device()
        self._driver = emulated(trajectory.camera, device, truth.sensor_camera, number, sums=flaws.sums_columns)
        self._exposure_us = self._first_us = trajectory.camera.exposure_us  # as read back, while it is open
        self._binning_gain, self._black_level, self.flaws = 1, 0.0, flaws
        self._maps: SensorMaps | None = None
        self._seen: tuple[tuple[int, bytes], NDArray[np.float32]] | None = None
        self._lens: Lens | None = None

    def __enter__(self) -> Self:
        self._driver.__enter__()
        self._exposure_us = self._first_us = self._driver.exposure_us
        self._binning_gain, self._black_level = self._driver.binning_gain, self._driver.black_level
        self._lens = Lens(self._driver.camera(self.truth.sensor_camera))
        if self.flaws != PERFECT:
            sensor = self.truth.sensor_camera
            self._maps = SensorMaps.of(self.flaws, self._driver.region, (sensor.width, sensor.height), self.seed)
        return self

    def __exit__(self, *exception: object) -> None:
        self._driver.__exit__(*exception)

    def prepare(self, frame: int) -> None:
        """Set the frame number of the next exposure, on which its noise depends."""
        self._frame = frame

    def grab(self) -> Image:
        """See `capture.drivers.protocols.Camera`. `device_ticks` are nanoseconds of the host clock, as for a USB camera."""
        settings, moment = self.trajectory.camera, time.monotonic_ns()
        exposure_us = self._exposure_us
        poses = self.truth.seen_from(self._arm.exposed(exposure_us * 1e-6, MOMENTS))
        poses = poses[blur_moments(self.lens.camera, poses)]
        self._world_from_camera = poses[len(poses) // 2]
        self._base_from_object = np.eye(4) if self._table is None else self._table.base_from_object()
        light = self._light(poses)
        if self.flaws.flicker:
            light = light * np.float32(lamp_light(self.flaws, moment * 1e-9, exposure_us * 1e-6))
        pixels = self.sensor.expose(
            light @ GREY if self.is_grey else light,
            exposure_us=exposure_us,
            gain_db=settings.gain_db,
            binning=settings.binning,
            rng=np.random.default_rng([self.seed, self._frame, 3, *self._again]),
            raw_bits=RAW_BITS[settings.pixel_format],
            maps=self._maps,
            binning_gain=self._binning_gain,
        )
        image = self._driver.expose(pixels, self._depth(), np.random.default_rng([self.seed, self._frame, 5]))
        if settings.pixel_format == "rgb8" and not np.array_equal(image.pixels, pixels):
            raise SimulationError("the emulated camera changed the picture", why="pixels differ from what it was fed")
        return replace(image, host_time_ns=moment, device_ticks=moment)

    def _light(self, poses: NDArray[np.float64]) -> NDArray[np.float32]:
        """Light on the pixels; that of the previous picture where nothing has moved since, as in a bracket of exposures."""
        burning = self._burning()
        seen = (self._seed, poses.tobytes() + self._base_from_object.tobytes() + bytes(burning))
        if self._seen is None or self._seen[0] != seen:
            if self.lamps:
                self.view.light(burning)
            self.view.turn(self._base_from_object)
            self._seen = (seen, self.view.radiance(self.lens, poses, self._seed))
        return self._seen[1]

    def _burning(self) -> tuple[bool, ...]:
        """Which of the lamps are on: what the controller's outputs are, whoever set them."""
        if not self.lamps:
            return ()
        bits = int(self._arm.signals()["digital"])
        return tuple(bool(bits >> output & 1) for output in self.lamps)

    def _depth(self) -> NDArray[np.float32] | None:
        """(height, width) true depth [m] where the camera measures it; None without a depth sensor."""
        camera = self._driver.depth_camera
        if camera is None:
            return None
        return self.view.depth(camera, self.world_from_camera @ camera_from_depth(), self._seed)

    def set_exposure(self, exposure_us: float) -> None:
        """See `capture.drivers.protocols.Camera`."""
        self._driver.set_exposure(exposure_us)
        self._exposure_us = self._driver.exposure_us

    @property
    def sensor(self) -> Sensor:
        """The sensor, without the flaws of single pixels."""
        return Sensor(black_level=self.flaws.black_level + self._black_level)

    @property
    def is_grey(self) -> bool:
        """Whether the sensor sees no colours."""
        return self.trajectory.camera.pixel_format.startswith("mono")

    @property
    def _again(self) -> list[int]:
        """What else the noise depends on: nothing in the first exposure of the trajectory's length, see `set_exposure`."""
        return [] if self._exposure_us == self._first_us else [round(self._exposure_us)]

    def description(self) -> dict[str, Any]:
        """See `capture.drivers.protocols.Camera`."""
        return {**self._driver.description(), "simulated": True}

    def save_truth(self, folder: Path, name: str, split: str) -> None:
        """Write the truth about the newest picture: its pose, and for test views the maps of `SUFFIXES`.

        folder/CHANNEL/NAME.*: `normals` (unit, in the object's frame of `datasets.turntable`, the base without a turntable),
        `depth` (along z [m], 0 outside the object), `alpha` (share of the pixel that shows the object), `diffuse` and
        `specular` (linear light that sums to the picture; 1 is its white).
        """
        if split == "test":
            white = Sensor().white(self._first_us, self.trajectory.camera.gain_db, self._binning_gain)
            for channel, values in self.view.truth(self.lens, self.world_from_camera, self._seed).items():
                if channel in LIGHT:
                    values = (values @ GREY if self.is_grey else values) / white
                images.write(folder / channel / f"{name}{SUFFIXES[channel]}", values)
        poses = folder / "poses.json"
        content = files.read_json(poses) if poses.exists() else self._session(folder)
        content["base_from_camera"][name] = self.base_from_camera.tolist()
        if self._table is not None:
            content["base_from_object"][name] = self._base_from_object.tolist()
        if self.truth.beside is not None:
            base_from_flange = self.base_from_camera @ pose.inverse(self.world_from_camera)
            content.setdefault("base_from_flange", {})[name] = base_from_flange.tolist()
        files.write_json(poses, content)

    def _session(self, folder: Path) -> dict[str, Any]:
        """The truth about all pictures; also writes the mesh of the object."""
        mesh = self.view.mesh()
        if mesh is not None:
            with files.atomic_path(folder / "object.ply") as temporary:
                mesh.export(temporary, file_type="ply", vertex_normal=True)
        lying = self.trajectory.board is not None and self.truth.beside is None
        carried = None if self.truth.beside is None else self.truth.beside.flange_from_board.tolist()
        return {
            "format": "koala-truth",
            "version": 1,
            "camera": self.lens.camera.to_json(),
            "sensor_camera": self.truth.sensor_camera.to_json(),
            "flange_from_camera": self.truth.flange_from_camera.tolist() if self.truth.beside is None else None,
            "flange_from_board": carried,
            "base_from_board": self.trajectory.base_from_board.tolist() if lying else None,
            "flaws": self.flaws.model_dump(mode="json"),
            "base_from_camera": {},
            **({} if self._table is None else {"turntable": self._table.truth.axis.to_json(), "base_from_object": {}}),
        }

    @property
    def lens(self) -> Lens:
        """The lens; only while the camera is open."""
        if self._lens is None:
            raise SimulationError("the camera is not open")
        return self._lens

    @property
    def base_from_camera(self) -> NDArray[np.float64]:
        """(4, 4) true camera pose in the middle of the newest exposure [m]."""
        return self.world_from_camera if self.truth.beside is None else self.truth.beside.base_from_camera

    @property
    def world_from_camera(self) -> NDArray[np.float64]:
        """(4, 4) the same in the frame of what is seen: the base, or the flange that carries the target [m]."""
        if self._world_from_camera is None:
            raise SimulationError("no picture has been taken yet")
        return self._world_from_camera

    @property
    def _seed(self) -> int:
        return int(np.random.SeedSequence([self.seed, self._frame]).generate_state(1)[0])
