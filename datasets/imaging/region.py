"""Region of interest and binning of a sensor, and their effect on intrinsics.

Calibration and recording may read out different regions of one sensor. In our pixel convention the conversion is exact: divide
by the binning, then shift by the offset.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any, Self

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError


@dataclass(frozen=True)
class Region:
    """Width, height and offsets in image pixels, that is after binning."""

    width: int
    height: int
    offset_x: int = 0
    """Left edge on the sensor [binned px]."""
    offset_y: int = 0
    """Upper edge on the sensor [binned px]."""
    binning: int = 1
    """Sensor pixels per image pixel along both axes."""

    def camera(self, sensor: Camera) -> Camera:
        """The camera of this region's images, given that of the whole unbinned sensor."""
        b = self.binning
        cx, cy = sensor.cx / b - self.offset_x, sensor.cy / b - self.offset_y
        return replace(sensor, width=self.width, height=self.height, fx=sensor.fx / b, fy=sensor.fy / b, cx=cx, cy=cy)

    def sensor_camera(self, camera: Camera, width: int, height: int) -> Camera:
        """The camera of the whole sensor of `width` x `height` [px], given that of this region's images."""
        b = self.binning
        cx, cy = (camera.cx + self.offset_x) * b, (camera.cy + self.offset_y) * b
        return replace(camera, width=width, height=height, fx=camera.fx * b, fy=camera.fy * b, cx=cx, cy=cy)

    def converted(self, camera: Camera, to: "Region") -> Camera:
        """The camera of images of region `to`, given that of this region's images."""
        return to.camera(self.sensor_camera(camera, self.width * self.binning, self.height * self.binning))

    def middle(self, width: int, height: int, binning: int) -> "Region":
        """The region of `width` x `height` [px after `binning`] about this one's centre, to the nearest pixel."""
        x, y = self.offset_x + self.width / 2, self.offset_y + self.height / 2
        left, top = (round(self.binning * at / binning - size / 2) for at, size in ((x, width), (y, height)))
        return Region(width, height, left, top, binning)

    def to_json(self) -> dict[str, int]:
        """Plain dictionary of the fields."""
        return asdict(self)

    @classmethod
    def of_recording(cls, manifest: dict[str, Any], *, where: object) -> Self | None:
        """The region that a recording's manifest states for its camera, if any."""
        camera = manifest.get("camera")
        content = camera.get("region") if isinstance(camera, dict) else None
        return None if content is None else cls.from_json(content, where=f"{where}, camera, region")

    @classmethod
    def from_json(cls, content: Any, *, where: object) -> Self:
        """Region from `to_json`'s dictionary; raises DatasetError where it is not valid."""
        try:
            region = cls(**{key: int(value) for key, value in content.items()})
        except (TypeError, ValueError, AttributeError) as error:
            raise DatasetError("sensor region is not complete", where=where, why=str(error)) from None
        if min(region.width, region.height, region.binning) < 1 or min(region.offset_x, region.offset_y) < 0:
            raise DatasetError("sensor region is impossible", where=where, why=str(content))
        return region
