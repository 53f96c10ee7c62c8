"""Agisoft Metashape's camera export (XML), read only.

Poses are chunk_from_camera in our axes (x right, y down, z forward), and pixel centres lie at +0.5 as ours do. The transform of
the component, in older files that of the chunk, leads into the world; where it has a scale, that of markers, scale bars or GPS,
the unit is the metre. Lens (Metashape user manual, appendix on camera models), with x = X / Z, y = Y / Z:

    x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8) + p1 (r^2 + 2 x^2) + 2 p2 x y
    u  = width / 2 + cx + x' (f + b1) + y' b2

so its p1 is OpenCV's p2, and the other way round, its principal point is an offset from the middle, and fx and fy are f + b1
and f.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, KoalaError
from koala3d.datasets.formats import assemble, opengl
from koala3d.datasets.formats.captures import shared
from koala3d.datasets.formats.finding.pictures import Listing, without_suffix
from koala3d.datasets.scene import Scene, View, with_test_views

LARGEST, HEAD = 2**28, 4096
"""Largest size of a file, and how much of it tells whether it is one [bytes]."""
FISHEYES = ("fisheye", "equidistant_fisheye")
SKEWED_PX = 0.5
"""A shear of the sensor that moves the picture's edge by more is not ignored [px]."""


def find(folder: Path) -> Path | None:
    """The camera export in a folder, `cameras.xml` preferred; None where there is none."""
    found = [path for path in sorted(folder.glob("*.xml")) if path.is_file() and _is_export(path)]
    return next((path for path in found if path.name == "cameras.xml"), found[0] if found else None)


def _is_export(path: Path) -> bool:
    try:
        with open(path, "rb") as file:
            head = file.read(HEAD)
    except OSError:
        return False
    return b"<document" in head and b"<chunk" in head


def detect(folder: Path) -> bool:
    """True for a folder with a camera export of Metashape."""
    return find(folder) is not None


@dataclass(frozen=True)
class _Export:
    """What a chunk says beside its cameras."""

    source: Path
    folder: Path
    sensors: dict[str, Element]
    worlds: dict[str, tuple[NDArray[np.float64], float]]
    """(4, 4) rigid world_from_chunk of each component by its id, and the scale of the chunk's positions in front of it; the empty
    id stands for the chunk."""
    any_lens: bool
    cameras: dict[str, Camera] = field(default_factory=dict)

    def placed(self, component: str, chunk_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
        """(4, 4) world_from_camera."""
        world_from_chunk, scale = self.worlds.get(component, self.worlds[""])
        return world_from_chunk @ pose.rigid(chunk_from_camera[:3, :3], scale * chunk_from_camera[:3, 3])

    def camera(self, sensor: str) -> Camera:
        """The camera of a sensor. Raises DatasetError if it is missing or not supported."""
        if sensor not in self.cameras:
            where = f"{self.source}, sensor {sensor}"
            if sensor not in self.sensors:
                raise DatasetError("sensor is not in the file", where=where)
            self.cameras[sensor] = _camera(self.sensors[sensor], self.folder, where, self.any_lens)
        return self.cameras[sensor]


def load(
    folder: Path,
    *,
    hold_out: int = 8,
    images_folder: str | None = None,
    problems: list[KoalaError] | None = None,
    any_lens: bool = False,
) -> Scene:
    """Read a camera export; every `hold_out`-th view by sorted name is a test view. `any_lens` as in `opengl.camera`.

    Raises:
        DatasetError: it is damaged, has no aligned cameras, or uses an unsupported lens.
    """
    source = find(folder)
    if source is None:
        raise DatasetError("holds no camera export of Metashape", where=folder)
    chunk = _chunk(source)
    sensors = {one.get("id", ""): one for one in chunk.findall("sensors/sensor")}
    export = _Export(source, folder, sensors, _worlds(chunk, source), any_lens)
    gathering = assemble.Gathering(folder, problems)
    listing, places = Listing(), shared.places(folder, images_folder)
    not_used: dict[str, list[str]] = {}
    for camera in _cameras(chunk):
        label = camera.get("label", "")
        with gathering.collecting():
            if (why := _unused(camera)) is not None:
                not_used.setdefault(why, []).append(label)
                continue
            image = shared.image(listing, places, label)
            if image is None:
                gathering.missing.append(label)
            else:
                gathering.views.append(_view(gathering, export, camera, image))
    gathering.notes += [f"{len(labels)} cameras {why} and are left out" for why, labels in not_used.items()]
    shared.with_masks(gathering)
    views, notes = shared.near_the_origin(gathering.finished(listed_in=source.name))
    gathering.notes += [*notes, *_about_scale(chunk, export)]
    scene = assemble.scene(gathering, with_test_views(views, hold_out), "metashape")
    return replace(scene, metric=_has_scale(chunk))


def _chunk(source: Path) -> Element:
    """The chunk that is used. Raises DatasetError if there are several that have cameras, or none."""
    root = files.parse_xml(files.read_text(source, LARGEST, suffixes=(".xml",)), where=source)
    chunks = [chunk for chunk in root.iter("chunk") if chunk.find("cameras") is not None]
    if len(chunks) != 1:
        remedy = "export the cameras of one chunk"
        raise DatasetError("is not the export of one chunk", where=source, why=f"{len(chunks)} have cameras", remedy=remedy)
    return chunks[0]


def _cameras(chunk: Element) -> Iterator[Element]:
    """All cameras, those in groups included."""
    return (camera for home in chunk.findall("cameras") for camera in home.iter("camera"))


def _unused(camera: Element) -> str | None:
    """Why a camera is not used; None if it is."""
    if camera.get("enabled") in ("false", "0"):
        return "are disabled"
    if camera.get("master_id") not in (None, camera.get("id")):
        return "follow another one of a rig"
    return "are not aligned" if camera.find("transform") is None else None


def _view(gathering: assemble.Gathering, export: _Export, camera: Element, image: Path) -> View:
    where = f"{export.source}, camera {camera.get('label')}"
    fitted = gathering.fitted(export.camera(camera.get("sensor_id", "")), image, where=where)
    chunk_from_camera = pose.checked(_numbers(camera.findtext("transform"), 16, where).reshape(4, 4), where=where)
    matrix = export.placed(camera.get("component_id", ""), chunk_from_camera)
    return View(without_suffix(image.relative_to(gathering.folder)), fitted, matrix, "train", image)


def _camera(sensor: Element, folder: Path, where: str, any_lens: bool) -> Camera:
    """The camera of an adjusted sensor. Raises DatasetError for lenses that `Camera` cannot hold, unless `any_lens` allows it."""
    found = sensor.findall("calibration")
    calibration = next((one for one in found if one.get("class") == "adjusted"), found[0] if found else None)
    if calibration is None:
        raise DatasetError("sensor has no calibration", where=where, remedy="align the photos, then export the cameras again")
    kind = calibration.get("type") or sensor.get("type") or "frame"
    if kind != "frame" and kind not in FISHEYES:
        remedy = opengl.PANORAMA if kind == "spherical" else "undistort the photos in Metashape, and export again"
        raise DatasetError(f"lens model {kind} is not supported", where=where, remedy=remedy)
    resolution = calibration.find("resolution")
    resolution = sensor.find("resolution") if resolution is None else resolution
    if resolution is None:
        raise DatasetError("sensor has no resolution", where=where)
    width, height = (int(_numbers(resolution.get(side), 1, where)[0]) for side in ("width", "height"))
    value = {name: float(_numbers(calibration.findtext(name, "0"), 1, where)[0]) for name in _TERMS}
    if abs(value["b2"]) * height / 2 > SKEWED_PX * abs(value["f"]):
        raise DatasetError("pixels are not rectangular", where=where, why=f"b2 is {value['b2']:g}", remedy="fit without b2")
    numbers: dict[str, Any] = {"width": width, "height": height, "fx": value["f"] + value["b1"], "fy": value["f"]}
    numbers |= {"cx": width / 2 + value["cx"], "cy": height / 2 + value["cy"], **{k: value[k] for k in ("k1", "k2", "k3")}}
    if value["p3"] or value["p4"]:
        raise assemble.foreign_lens("with p3 and p4", folder, where=where)
    if kind in FISHEYES:
        if value["p1"] or value["p2"]:
            raise assemble.foreign_lens("a fisheye with p1 and p2", folder, where=where)
        return Camera.from_json({**numbers, "k4": value["k4"], "fisheye": True}, where=where)
    camera = Camera.from_json({**numbers, "p1": value["p2"], "p2": value["p1"]}, where=where)
    if value["k4"] and not any_lens:
        raise assemble.foreign_lens(f"with k4 = {value['k4']:g} as the fourth radial coefficient", folder, where=where)
    return opengl.PolynomialCamera.of(camera, value["k4"]) if value["k4"] else camera


_TERMS = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")


def _numbers(text: str | None, count: int, where: object) -> NDArray[np.float64]:
    """(count,) finite numbers. Raises DatasetError for anything else."""
    try:
        found = np.array((text or "").split(), np.float64)
    except ValueError:
        found = np.zeros(0)
    if found.shape != (count,) or not np.isfinite(found).all():
        raise DatasetError(f"expected {count} numbers", where=where, why=repr((text or "")[:60]))
    return found


def _worlds(chunk: Element, source: Path) -> dict[str, tuple[NDArray[np.float64], float]]:
    """Transform of the chunk by the empty id, and of each component that has one; a missing one is the identity."""
    worlds = {"": _world(chunk.find("transform"), source)}
    for component in chunk.findall("components/component"):
        if component.find("transform") is not None:
            worlds[component.get("id", "")] = _world(component.find("transform"), source)
    return worlds


def _world(transform: Element | None, source: Path) -> tuple[NDArray[np.float64], float]:
    if transform is None or transform.find("rotation") is None:
        return np.eye(4), 1.0
    where = f"{source}, transform"
    rotation = _numbers(transform.findtext("rotation"), 9, where).reshape(3, 3)
    translation = _numbers(transform.findtext("translation", "0 0 0"), 3, where)
    scale = float(_numbers(transform.findtext("scale", "1"), 1, where)[0])
    if not scale > 0:
        raise DatasetError("scale is not positive", where=where, why=f"{scale:g}")
    return pose.checked(pose.rigid(rotation, translation), where=where), scale


def _has_scale(chunk: Element) -> bool:
    places = [chunk.find("transform"), *(one.find("transform") for one in chunk.findall("components/component"))]
    return any(place is not None and place.find("scale") is not None for place in places)


def _about_scale(chunk: Element, export: _Export) -> list[str]:
    """Where the unit comes from."""
    bars = [bar for bar in chunk.iter("scalebar") if (stated := bar.find("reference")) is not None and stated.get("distance")]
    if not _has_scale(chunk):
        more = f": {len(bars)} scale bars are there, so update the reference in Metashape and export again" if bars else ""
        return [f"{export.source.name} has no scale, the unit is not the metre{more}"]
    return [f"the unit is the metre by {len(bars)} scale bars"] if bars else []
