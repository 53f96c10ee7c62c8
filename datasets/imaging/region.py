"""Which part of the sensor a picture shows: region of interest and binning, and what they do to the intrinsics.

A lens is calibrated for the whole sensor; a recording may read out less of it. Both pictures are areas of the same
sensor in our pixel convention, so that the change is exact: shift by the offset, then divide by the binning.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any, Self

from datasets.camera_model import Camera
from datasets.core.errors import DatasetError


@dataclass(frozen=True)
class Region:
    """Width, height and offsets in pixels of the picture, that is after binning."""

    width: int
    height: int
    offset_x: int = 0
    """Left edge on the sensor [binned px]."""
    offset_y: int = 0
    """Upper edge on the sensor [binned px]."""
    binning: int = 1
    """Sensor pixels per picture pixel along both axes."""

    def camera(self, sensor: Camera) -> Camera:
        """The camera of this region's pictures, given that of the whole unbinned sensor."""
        b = self.binning
        return replace(
            sensor,
            width=self.width,
            height=self.height,
            fx=sensor.fx / b,
            fy=sensor.fy / b,
            cx=sensor.cx / b - self.offset_x,
            cy=sensor.cy / b - self.offset_y,
        )

    def sensor_camera(self, camera: Camera, width: int, height: int) -> Camera:
        """The camera of the whole sensor of `width` x `height` [px], given that of this region's pictures."""
        b = self.binning
        return replace(
            camera,
            width=width,
            height=height,
            fx=camera.fx * b,
            fy=camera.fy * b,
            cx=(camera.cx + self.offset_x) * b,
            cy=(camera.cy + self.offset_y) * b,
        )

    def converted(self, camera: Camera, to: "Region") -> Camera:
        """The camera of pictures of region `to`, given that of this region's pictures."""
        return to.camera(self.sensor_camera(camera, self.width * self.binning, self.height * self.binning))

    def to_json(self) -> dict[str, int]:
        """Plain dictionary of the fields."""
        return asdict(self)

    @classmethod
    def from_json(cls, content: Any, *, where: object) -> Self:
        """Region from `to_json`'s dictionary; raises DatasetError where it is not complete."""
        try:
            region = cls(**{key: int(value) for key, value in content.items()})
        except (TypeError, ValueError, AttributeError) as error:
            raise DatasetError("sensor region is not complete", where=where, why=str(error)) from None
        if min(region.width, region.height, region.binning) < 1 or min(region.offset_x, region.offset_y) < 0:
            raise DatasetError("sensor region is impossible", where=where, why=str(content))
        return region
