"""The devices through which a simulation delivers its light: the vendors' own emulations, so that the drivers really run.

pylon's emulation shows picture files; librealsense's software device is fed pictures and depth. Cameras of other drivers are
simulated through pylon's, with the settings of the trajectory.
"""

from abc import ABC, abstractmethod
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.cameras.base import CameraDriver
from koala3d.capture.drivers.cameras.basler import Basler, serial_of
from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.drivers.measurements import Image, Pixels
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings
from koala3d.capture.sim.realsense_device import BASELINE_M, UNIT_M, SoftwareRealSense
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging import images
from koala3d.datasets.imaging.region import Region
from koala3d.datasets.radiometry.response import added_black

STEREO_BASELINE_M = 0.05
"""Between the infrared sensors of a D435."""
DISPARITY_PX, MOST_PX = 0.08, 126.0
"""Standard deviation of a disparity, and the largest that is searched: nearer surfaces have no depth."""


class Emulated(ABC):
    """A camera that shows what it is given, through a driver."""

    def __init__(self, driver: CameraDriver) -> None:
        self._driver = driver

    def __enter__(self) -> Self:
        self._driver.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self._driver.__exit__(*exception)

    @abstractmethod
    def camera(self, sensor_camera: Camera) -> Camera:
        """The true camera of the pictures, given that of the whole sensor."""

    @property
    @abstractmethod
    def region(self) -> Region:
        """The pixels whose flaws are simulated."""

    @property
    def depth_camera(self) -> Camera | None:
        """The camera of its depth; None without a depth sensor."""
        return None

    @abstractmethod
    def expose(self, pixels: Pixels, depth: NDArray[np.float32] | None, rng: np.random.Generator) -> Image:
        """Deliver a picture, and (height, width) true depth along z [m] with the noise of the depth sensor."""

    def set_exposure(self, exposure_us: float) -> None:
        """See `capture.drivers.protocols.Camera`."""
        self._driver.set_exposure(exposure_us)

    @property
    def exposure_us(self) -> float:
        """The exposure time that the driver reads back [us]."""
        return float(self._driver.description()["exposure_us"])

    @property
    def binning_gain(self) -> int:
        """How many times as bright as an unbinned pixel a binned one is, at the same exposure time."""
        return int(self._driver.description().get("binning_gain", 1))

    @property
    def black_level(self) -> float:
        """What the camera adds to every value by its settings [share of the largest value]."""
        return added_black(self._driver.description())

    def description(self) -> dict[str, Any]:
        """See `capture.drivers.protocols.Camera`."""
        return self._driver.description()


class EmulatedBasler(Emulated):
    """The emulated camera of pylon with a number, from 0: each can be opened once. `sums`: see `Basler`."""

    def __init__(self, settings: CameraSettings, number: int = 0, *, sums: bool = False, radiometry: str = "") -> None:
        device = Device(serial=serial_of(number), radiometry=radiometry)
        self._basler, self._count = Basler(settings, device, emulated=True, sums=sums), 0
        super().__init__(self._basler)
        self._folder: TemporaryDirectory[str] | None = None  # while it is open

    def __enter__(self) -> Self:
        self._folder = TemporaryDirectory(prefix="koala-camera-")
        try:
            self._driver.__enter__()
        except BaseException:
            self._folder.cleanup()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        self._driver.__exit__(*exception)
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def camera(self, sensor_camera: Camera) -> Camera:
        """See `Emulated`."""
        return self.region.camera(sensor_camera)

    @property
    def region(self) -> Region:
        """See `Emulated`."""
        return self._basler.region

    def expose(self, pixels: Pixels, depth: NDArray[np.float32] | None, rng: np.random.Generator) -> Image:
        """See `Emulated`; there is no depth."""
        if self._folder is None:
            raise CaptureError("camera is closed", remedy="open it first")
        self._count += 1
        picture = Path(self._folder.name) / f"{self._count}.png"
        images.write(picture, pixels)
        self._basler.feed(str(picture))
        image = self._driver.grab()
        picture.unlink()
        return image


class EmulatedRealSense(Emulated):
    """librealsense's software device. It sends only during an exposure, so that rendering has the processor for itself."""

    def __init__(self, settings: CameraSettings, device: Device, sensor_camera: Camera) -> None:
        from koala3d.capture.drivers.cameras.realsense import RealSense

        self._settings, self._device = settings, device
        self._source = SoftwareRealSense(sensor_camera)
        super().__init__(RealSense(settings, device.model_copy(update={"serial": ""}), emulation=self._source))

    def __enter__(self) -> Self:
        super().__enter__()
        self._source.stop()
        return self

    def camera(self, sensor_camera: Camera) -> Camera:
        """See `Emulated`."""
        return self._source.colour_camera(self._settings.width, self._settings.height)

    @property
    def region(self) -> Region:
        """See `Emulated`."""
        return Region(self._settings.width, self._settings.height)

    @property
    def depth_camera(self) -> Camera | None:
        """See `Emulated`."""
        depth = self._device.depth
        return None if depth is None else self._source.depth_camera(depth.width, depth.height)

    def expose(self, pixels: Pixels, depth: NDArray[np.float32] | None, rng: np.random.Generator) -> Image:
        """See `Emulated`."""
        if pixels.dtype != np.uint8:
            raise CaptureError(
                "camera sends 8 bits", why=f"{pixels.dtype} was simulated", remedy="set camera.pixel_format to rgb8"
            )
        measured = None
        if depth is not None and self.depth_camera is not None:
            measured = stereo_depth(depth, self.depth_camera.fx, rng)
        self._source.show(pixels.astype(np.uint8), measured)
        self._source.start()
        try:
            return self._driver.grab()
        finally:
            self._source.stop()


def camera_from_depth() -> NDArray[np.float64]:
    """(4, 4) where the simulated depth is measured, in the colour camera [m]."""
    matrix = np.eye(4)
    matrix[0, 3] = -BASELINE_M
    return matrix


def stereo_depth(depth: NDArray[np.float32], focal_px: float, rng: np.random.Generator) -> NDArray[np.uint16]:
    """What a stereo sensor makes of (height, width) true depth [m], in steps of `UNIT_M`; 0 where it measures nothing.

    Its error is that of the disparity f b / z, so that it grows with the square of the depth. Real sensors also fail on shine,
    which is not simulated.
    """
    scale = focal_px * STEREO_BASELINE_M
    disparity = scale / np.where(depth > 0, depth, np.inf) + rng.normal(0, DISPARITY_PX, depth.shape)
    seen = (depth > 0) & (disparity < MOST_PX) & (disparity > DISPARITY_PX)
    steps = np.where(seen, scale / np.where(seen, disparity, 1.0) / UNIT_M, 0)
    return np.where(steps < 2**16, np.rint(steps), 0).astype(np.uint16)


def emulated(settings: CameraSettings, device: Device, sensor_camera: Camera, number: int = 0, *, sums: bool = False) -> Emulated:
    """The emulation for the camera of a rig with a number, from 0; `sums`: see `Basler`."""
    if device.model == "realsense":
        return EmulatedRealSense(settings, device, sensor_camera)
    return EmulatedBasler(settings, number, sums=sums, radiometry=device.radiometry)
