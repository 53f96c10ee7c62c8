"""Single-lens reflex and mirrorless cameras by USB through libgphoto2. The only module that imports gphoto2.

Settings have the names that `gphoto2 --list-config` prints; each is one of a list of words. Exposure is `shutterspeed`, gain is
`iso` (0 dB is ISO 100). JPEG pictures are decoded; raw formats differ by maker and are not developed here.
"""

import os
import re
import time
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.capture.drivers.cameras import refusals
from koala3d.capture.drivers.cameras.base import only_one
from koala3d.capture.drivers.cameras.deadline import PatientCamera
from koala3d.capture.drivers.cameras.nodes import put, put_all
from koala3d.capture.drivers.errors import CaptureError, RigConnectionError
from koala3d.capture.drivers.measurements import Image, Pixels
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings

ANSWER_S, TRANSFER_S = 10.0, 30.0  # longest time for a setting, and for a picture beyond its exposure [s]
BASE_ISO = 100.0
"""Sensitivity of 0 dB."""
OFF = {"autofocus": "Off", "isoauto": "Off", "autoiso": "Off"}
"""Automatic functions, by the names of several makers, set where a camera has them."""
DIALS = {"expprogram": ("M", "Manual"), "autoexposuremode": ("Manual",), "whitebalance": None, "focusmode": None}
"""Settings that must not be automatic; a dial or a ring of the camera may decide. None: anything that does not say auto."""
SERIALS = ("serialnumber", "eosserialnumber")
VIRTUAL = "VCAMERADIR"
"""Variable that makes libgphoto2's virtual camera show the JPEG files of a folder; read when gphoto2 is imported."""


class GphotoCamera(PatientCamera):
    """One camera with fixed exposure, sensitivity and focus, released by USB.

    Its pictures are fetched and then deleted from the camera; pictures that were there before are left.

    Args:
        pictures: folder of JPEG files for libgphoto2's virtual camera, in place of a real one. Once in a process: gphoto2 must
            not have been imported before.

    Raises:
        RigConnectionError: there is no camera, or several and no serial number, or it is busy, or does not answer in time.
        CaptureError: a setting was rejected (requested and actual value), or a dial of the camera stands on automatic.
    """

    busy = "close other programs that use it (also the desktop's own), or plug it in again"
    answer_s = ANSWER_S

    def __init__(self, settings: CameraSettings, device: Device, *, pictures: Path | None = None) -> None:
        super().__init__(settings, device)
        self.pictures = pictures
        self._model = self._serial = ""

    def grab(self) -> Image:
        """Release the shutter, fetch the picture and decode it."""
        begun, exposure_us = time.monotonic_ns(), self._exposure_us
        try:
            data, ticks = self._call(TRANSFER_S + exposure_us * 1e-6, self._taken)
        except Exception as error:
            if not _is_vendors(error):
                raise
            remedy = "check cable, battery, card and focus, then resume with --resume"
            raise RigConnectionError("camera gave no image", where=self.name, why=str(error), remedy=remedy) from None
        return Image(self._decoded(data), exposure_us, self._gain_db, ticks, begun)

    def set_exposure(self, exposure_us: float) -> None:
        """Change the exposure time of the next pictures [us]. Raises CaptureError: the camera has no such time."""
        self._call(ANSWER_S, self._set_exposure, exposure_us)

    def description(self) -> dict[str, Any]:
        """Model, serial number, exposure, and all settings that can be read."""
        state = self._call(self.set_up_s, self.nodes.values)
        return {
            "driver": "gphoto2",
            "model": self._model,
            "serial": self._serial,
            "firmware": str(state.get("deviceversion", "")),
            "virtual": self.pictures is not None,
            "sensor": {"width": self.settings.width, "height": self.settings.height},
            "exposure_us": self._exposure_us,
            "gain_db": self._gain_db,
            "pixel_format": self.settings.pixel_format,
            "left": list(self.device.leave),
            "state": state,
        }

    @property
    def nodes(self) -> "ConfigNodes":
        """Its configuration."""
        return ConfigNodes(self._camera)

    @property
    def serial(self) -> str:
        """Its serial number."""
        return self._serial

    @property
    def facts(self) -> dict[str, str]:
        """See `InspectedCamera`."""
        return {"firmware": str(self.nodes.read("deviceversion"))}

    @staticmethod
    def _is_vendors(error: BaseException) -> bool:
        return _is_vendors(error)

    def _connect(self) -> None:
        if self.pictures is not None:
            os.environ[VIRTUAL] = str(self.pictures)
        gphoto2 = _library()
        listed = gphoto2.Camera.autodetect()
        places = [(listed.get_name(number), listed.get_value(number)) for number in range(len(listed))]
        wanted, remedy = self.device.serial, "switch it on, check cable and camera.serial, and set its USB mode to PTP"
        if not wanted:
            words = ", ".join(f"{model} at {port}" for model, port in places)
            places = [only_one([("", place) for place in places], "", self.name, words=words, remedy=remedy)]
        others: list[tuple[str, None]] = []
        for model, port in places:
            camera = _at(gphoto2, model, port)
            nodes = ConfigNodes(camera)
            serial = next((str(nodes.read(name)) for name in SERIALS if nodes.has(name)), "")
            if wanted in ("", serial):
                self._camera, self._model, self._serial = camera, model, serial
                return
            others.append((serial or model, None))
            camera.exit()
        only_one(others, wanted, self.name, remedy=remedy)

    def _configure(self) -> None:
        wanted, device, where, nodes = self.settings, self.device, self.name, self.nodes
        refusals.refuse_format(wanted, ("rgb8",), where)
        refusals.refuse_region(wanted, where)
        for name, value in OFF.items():
            if nodes.has(name) and name not in device.settings:
                put(nodes, name, value)
        self._set_size(nodes)
        if "exposure_us" not in device.leave:
            self._set_exposure(wanted.exposure_us)
        if "gain_db" not in device.leave:
            if not nodes.has("iso"):
                refusals.require_left(device, "gain_db", "it has no iso", where)
            speeds = {word: float(word) for word in nodes.symbolics("iso") if word.isdigit()}
            put(nodes, "iso", refusals.nearest_choice(BASE_ISO * 10 ** (wanted.gain_db / 20), speeds, "iso", where))
        put_all(nodes, device.settings, where)
        for name, allowed in DIALS.items():
            value = str(nodes.read(name)) if nodes.has(name) else ""
            if value and ("auto" in value.lower() if allowed is None else value not in allowed):
                remedy = f"set it at the camera, or {name} in camera.settings"
                raise CaptureError(f"camera's {name} is automatic", where=where, why=f"it is {value}", remedy=remedy)

    def _set_size(self, nodes: "ConfigNodes") -> None:
        """The size of the pictures, where the camera calls it by width and height."""
        wanted = f"{self.settings.width}x{self.settings.height}"
        sizes = [word for word in nodes.symbolics("imagesize") if re.fullmatch(r"\d+x\d+", word)]
        if not sizes or nodes.read("imagesize") == wanted:
            return
        if wanted not in sizes:
            size = tuple(int(edge) for edge in str(nodes.read("imagesize")).split("x"))
            refusals.refuse_size(self.settings, (size[0], size[1]), self.name, ", ".join(sizes))
        put(nodes, "imagesize", wanted)

    def _set_exposure(self, exposure_us: float) -> None:
        nodes, where = self.nodes, self.name
        if not nodes.has("shutterspeed") or "exposure_us" in self.device.leave:
            why, remedy = "it has no shutterspeed, or camera.leave names it", "list exposure_us in camera.leave"
            raise CaptureError("camera takes no exposure time", where=where, why=why, remedy=remedy)
        times = {word: us for word in nodes.symbolics("shutterspeed") if (us := microseconds(word)) is not None}
        put(nodes, "shutterspeed", refusals.nearest_choice(exposure_us, times, "shutterspeed", where))

    @property
    def _exposure_us(self) -> float:
        """As the camera reports it; that of the trajectory where it is left."""
        found = self._reported("shutterspeed") if "exposure_us" not in self.device.leave else None
        read = None if found is None else microseconds(found)
        return self.settings.exposure_us if read is None else read

    @property
    def _gain_db(self) -> float:
        found = self._reported("iso") if "gain_db" not in self.device.leave else None
        return self.settings.gain_db if found is None else float(20 * np.log10(float(found) / BASE_ISO))

    def _reported(self, name: str) -> str:
        return str(self._call(ANSWER_S, self.nodes.read, name))

    def _taken(self) -> tuple[bytes, int]:
        """The file of one picture and its time by the camera's clock [ns]; the picture is deleted from the camera."""
        gphoto2 = _library()
        camera = self._camera
        path = camera.capture(gphoto2.GP_CAPTURE_IMAGE)
        stamp_s = int(camera.file_get_info(path.folder, path.name).file.mtime)
        file = camera.file_get(path.folder, path.name, gphoto2.GP_FILE_TYPE_NORMAL)
        data = bytes(memoryview(file.get_data_and_size()))  # the memory belongs to the file
        camera.file_delete(path.folder, path.name)
        return data, stamp_s * 10**9

    def _decoded(self, data: bytes) -> Pixels:
        import cv2

        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION)
        if picture is None:
            remedy = "set imagequality or imageformat in camera.settings to a JPEG"
            raise CaptureError("camera sent no JPEG", where=self.name, why=f"begins with {data[:4].hex()}", remedy=remedy)
        refusals.refuse_size(self.settings, (picture.shape[1], picture.shape[0]), self.name)
        return picture.astype(np.uint8, copy=False)

    def _release(self, camera: Any) -> None:
        camera.exit()


class ConfigNodes:
    """`capture.drivers.cameras.nodes.Nodes` of an opened camera: the words of its configuration."""

    def __init__(self, camera: Any) -> None:
        self._camera = camera

    def has(self, name: str) -> bool:
        """Whether the camera has a setting of this name now; it may depend on its dials."""
        return self._widget(name) is not None

    def read(self, name: str) -> Any:
        """Its value."""
        widget = self._widget(name)
        return "" if widget is None else widget.get_value()

    def symbolics(self, name: str) -> Collection[str]:
        """The words that it may be; empty for a number or a text, and where there is none."""
        gphoto2 = _library()
        widget = self._widget(name)
        if widget is None or widget.get_type() not in (gphoto2.GP_WIDGET_RADIO, gphoto2.GP_WIDGET_MENU):
            return ()
        return tuple(widget.get_choice(number) for number in range(widget.count_choices()))

    def write(self, name: str, value: Any) -> None:
        """Set it. Raises CaptureError: it cannot be changed, or the word is none of its own."""
        widget, choices = self._widget(name), self.symbolics(name)
        remedy = "change the camera settings"
        if choices and value not in choices:
            why = f"requested {value}, possible: {', '.join(choices)}"
            raise CaptureError(f"camera rejected {name}", why=why, remedy=remedy)
        if widget is None or widget.get_readonly():
            why, remedy = f"it stays at {self.read(name)}", "change it at the camera"
            raise CaptureError(f"camera's {name} cannot be changed from here", why=why, remedy=remedy)
        try:
            widget.set_value(value)
            self._camera.set_single_config(name, widget)
        except Exception as error:
            if not (_is_vendors(error) or isinstance(error, TypeError)):
                raise
            raise CaptureError(f"camera rejected {name}", why=f"requested {value}: {error}", remedy=remedy) from None

    def values(self) -> dict[str, Any]:
        """All settings that can be read."""
        found: dict[str, Any] = {}
        waiting = [self._camera.get_config()]
        while waiting:
            widget = waiting.pop(0)
            children = [widget.get_child(number) for number in range(widget.count_children())]
            waiting += children
            if not children and isinstance(value := widget.get_value(), int | float | str):
                found[widget.get_name()] = value
        return found

    def _widget(self, name: str) -> Any:
        try:
            return self._camera.get_single_config(name)
        except Exception as error:
            if _is_vendors(error):
                return None
            raise


def microseconds(word: str) -> float | None:
    """The exposure time that a camera calls `1/125`, `0.5`, `2`, or `0.0100s` [us]; None for words such as bulb."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)(?:/(\d+(?:\.\d+)?))?\s*s?", word.strip())
    if match is None or not float(match[2] or 1):
        return None
    return 1e6 * float(match[1]) / float(match[2] or 1) or None


def _at(gphoto2: Any, model: str, port: str) -> Any:
    """The camera at a port, opened."""
    camera, ports, models = gphoto2.Camera(), gphoto2.PortInfoList(), gphoto2.CameraAbilitiesList()
    ports.load()
    models.load()
    camera.set_port_info(ports[ports.lookup_path(port)])
    camera.set_abilities(models[models.lookup_model(model)])
    camera.init()
    return camera


def _is_vendors(error: BaseException) -> bool:
    """Whether an exception is libgphoto2's."""
    return isinstance(error, _library().GPhoto2Error)


def _library() -> Any:
    """The package, imported where it is first needed; its names are made at run time."""
    import gphoto2

    return gphoto2
