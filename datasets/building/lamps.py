"""What the lamps of a recording stand on, as its rig file says and its frames tell which were on."""

from dataclasses import dataclass
from typing import Any

from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.recording import MANIFEST, Recording
from koala3d.datasets.scene import SPLITS, LampsName

STANDS: dict[str, LampsName] = {"room": "room", "flange": "camera", "turntable": "object"}
"""What a lamp stands on as scenes have it, by what rig files say."""
DARK = "dark"
"""Name of the scene of the views for which every lamp was off."""


def lamp_sets(recording: Recording) -> dict[str, tuple[str, ...] | None]:
    """The sets of lamps under which a recording's views of an object were taken, each by the name that its scene gets."""
    sets = dict.fromkeys(frame.lights for frame in recording.frames if frame.split in SPLITS)
    return {DARK if not lights else "+".join(lights): lights for lights in sets}


@dataclass(frozen=True)
class Light:
    """`Scene.lamps`, and what a person should know about them."""

    lamps: LampsName | None = None
    notes: tuple[str, ...] = ()


def light_of(recording: Recording) -> Light:
    """What the lamps of a recording stand on. None: nobody said, or there is no single answer.

    Raises DatasetError: a frame names a lamp that the rig file in the manifest does not have.
    """
    stands, notes = _stands(recording), []
    if stands is None:
        if not recording.turns:
            return Light()
        stands = {"room"}
        notes.append("the rig file names no lamps; they are taken to stand in the room, before which the object turned")
    kinds = {STANDS[stand] for stand in stands}
    if not recording.turns:  # what stands on the table stands in the room
        kinds = {"room" if kind == "object" else kind for kind in kinds}
    if not kinds:
        return Light(notes=("every lamp was off; what lit the object is not known",))
    if len(kinds) != 1:
        notes.append(f"lamps stood on {' and '.join(f'the {kind}' for kind in sorted(kinds))}; no single frame is right for all")
        return Light(notes=tuple(notes))
    return Light(kinds.pop(), tuple(notes))


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
