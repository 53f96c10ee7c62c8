"""Where the lamps of a recording stand still, as its rig file says and its frames tell which were on.

A lamp stands in the room, on the flange, or on the turntable. Seen from the object that is the light frame

    stands       object stands   object turns
    room         world           turntable
    flange       camera          camera
    turntable    world           world
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.recording import MANIFEST, Recording
from koala3d.datasets.scene import SPLITS, LightFrameName, View
from koala3d.datasets.turntable import Axis

STANDS: dict[str, tuple[LightFrameName, LightFrameName]] = {
    "room": ("world", "turntable"),
    "flange": ("camera", "camera"),
    "turntable": ("world", "world"),
}
"""Light frame by where a lamp stands, for an object that stands and for one that turns."""
ALIKE_DEG = 5.0
"""Azimuths of the cameras in the room may differ by so much: the frame "turntable" takes them to be one."""


DARK = "dark"
"""Name of the scene of the views for which every lamp was off."""


def lamp_sets(recording: Recording) -> dict[str, tuple[str, ...] | None]:
    """The sets of lamps under which a recording's views of an object were taken, each by the name that its scene gets."""
    sets = dict.fromkeys(frame.lights for frame in recording.frames if frame.split in SPLITS)
    return {DARK if not lights else "+".join(lights): lights for lights in sets}


@dataclass(frozen=True)
class Light:
    """`Scene.light_frame` and `light_axis`, and what a person should know about them."""

    frame: LightFrameName | None = None
    axis: tuple[float, float, float] | None = None
    notes: tuple[str, ...] = ()


def light_of(recording: Recording, views: tuple[View, ...], axis: Axis | None) -> Light:
    """The light frame of a recording's views. Frame None: nobody said, or there is no single one.

    Args:
        views: of the recording, in the world of `datasets.turntable`.
        axis: of the turntable, where it is known.

    Raises DatasetError: a frame names a lamp that the rig file in the manifest does not have.
    """
    turned, stands, notes = recording.turns, _stands(recording), []
    if stands is None:
        if not turned:
            return Light()
        stands = {"room"}
        notes.append("the rig file names no lamps; they are taken to stand in the room, before which the object turned")
    kinds = {STANDS[stand][turned] for stand in stands}
    if len(kinds) != 1:
        if not kinds:
            return Light(notes=("every lamp was off; the light frame is not known",))
        notes.append(f"lamps stood still in the frames of {' and '.join(sorted(kinds))}; none of them is right for all")
        return Light(notes=tuple(notes))
    kind = kinds.pop()
    if kind != "turntable" or axis is None:
        return Light(kind, notes=tuple(notes))
    spread = _azimuths_deg(recording, views, axis)
    if spread > ALIKE_DEG:
        why = f"the camera's azimuth about the turntable varies by {spread:.0f} degrees in the room"
        return Light(notes=(*notes, f"{why}; the light frame 'turntable' needs one azimuth, so none is stated"))
    x, y, z = axis.direction.tolist()
    return Light(kind, (x, y, z), tuple(notes))


def _stands(recording: Recording) -> set[str] | None:
    """Where the lamps that were on stand; None where the rig file names no lamps or a frame does not say which were on."""
    rig = recording.part("rig")
    lamps, switched = rig.get("lights") or [], rig.get("lamps")
    names = [frame.lights for frame in recording.frames]
    known = dict.fromkeys(switched, "room") if isinstance(switched, dict) else {}
    known |= {one["name"]: one["stands"] for one in lamps if _is_lamp(one)}
    if not known or None in names:
        return None
    on = {name for some in names for name in some or ()}
    if not on <= known.keys():
        why = f"{', '.join(sorted(on - known.keys()))}; the rig file has {', '.join(known) or 'none'}"
        raise DatasetError("a frame was lit by an unknown lamp", where=recording.path / MANIFEST, why=why)
    return {known[name] for name in on}


def _is_lamp(content: Any) -> bool:
    return isinstance(content, dict) and isinstance(content.get("name"), str) and content.get("stands") in STANDS


def _azimuths_deg(recording: Recording, views: tuple[View, ...], axis: Axis) -> float:
    """Range of the azimuths from which cameras looked, about the axis in the room [degrees]."""
    angles = {frame.name: frame.turntable_angle or 0.0 for frame in recording.frames}
    back = np.stack(
        [axis.base_from_object(angles[view.name])[:3, :3] @ -view.world_from_camera[:3, 2] for view in views]
    )  # in the room
    level = back - (back @ axis.direction)[:, None] * axis.direction
    level = level[np.linalg.norm(level, axis=1) > 0.05]  # others look along the axis and have no azimuth
    if len(level) < 2:
        return 0.0
    first = level[0] / np.linalg.norm(level[0])
    turned = np.arctan2(level @ np.cross(axis.direction, first), level @ first)
    return float(np.rad2deg(turned.max() - turned.min()))
