"""What a rig file says about its camera as a device: which driver, which device, and settings in the device's own words.

The settings that all cameras share (exposure, gain, format, size) belong to the trajectory. A driver translates them, reads each
back, and refuses what the device does not take. `leave` names those that a device cannot take, so that they are left on purpose.
"""

from typing import Literal, Self

from pydantic import Field, model_validator

from koala3d.datasets.core.schema import Schema

Value = bool | int | float | str
Left = Literal["exposure_us", "gain_db", "colour_space", "factory_settings", "trigger"]
USES: dict[str, set[str]] = {
    "basler": {"settings"},
    "genicam": {"source", "settings", "leave"},
    "opencv": {"source", "settings", "leave"},
    "realsense": {"settings", "leave", "depth"},
    "gphoto2": {"settings", "leave"},
}
"""For each driver, the keys of the rig file beyond model and serial that it heeds; others would be ignored in silence."""


class DepthStream(Schema):
    """Depth that a camera measures beside its pictures."""

    width: int = Field(default=640, ge=16, description="width of the depth picture [px]")
    height: int = Field(default=480, ge=16, description="its height [px]")


class Device(Schema):
    """Which camera it is, and its settings that no other camera has."""

    model: Literal["basler", "genicam", "opencv", "realsense", "gphoto2"] = Field(default="basler", description="kind of camera")
    serial: str = Field(default="", description="serial number; empty: the only connected camera")
    source: str = Field(
        default="",
        description="opencv: number of a webcam, or a video or numbered pictures ('shots/%03d.png'); "
        "genicam: the GenTL producer (.cti), empty: those of GENICAM_GENTL64_PATH",
    )
    radiometry: str = Field(
        default="",
        description="file that 'capture flat' has written, relative to the rig file; recordings keep a copy of it; empty: none",
    )
    settings: dict[str, Value] = Field(
        default={}, description="more settings by the names that the camera gives them; written last, and read back"
    )
    leave: list[Left] = Field(default=[], description="settings that this camera does not have; they are not written")
    depth: DepthStream | None = Field(default=None, description="realsense: keep its depth beside each picture; null: no")

    @model_validator(mode="after")
    def _heeded(self) -> Self:
        """Refuse keys that the driver would not look at."""
        given = {key for key in ("source", "settings", "leave", "depth") if getattr(self, key)}
        if unused := sorted(given - USES[self.model]):
            raise ValueError(f"{', '.join(unused)} means nothing to {self.model}: remove it")
        return self
