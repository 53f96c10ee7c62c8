"""The table of formats that `calib export` writes."""

from collections.abc import Callable
from dataclasses import dataclass

from koala3d.calib.export import cameras, trajectories, transforms
from koala3d.calib.export.source import Source


@dataclass(frozen=True)
class Format:
    """A file of another program."""

    suffixes: tuple[str, ...]
    """One of them ends the name, or its readers do not find or take the file."""
    write: Callable[[Source], str]
    """Text of the file."""


YAML = (".yaml", ".yml")
FORMATS = {
    "opencv": Format(YAML, cameras.opencv),
    "ros": Format(YAML, cameras.camera_info),
    "kalibr": Format(YAML, cameras.camchain),
    "easy_handeye2": Format((".calib",), transforms.easy_handeye2),
    "urdf": Format((".urdf",), transforms.urdf),
    "xacro": Format((".xacro",), transforms.xacro),
    "moveit": Format((".xml",), transforms.launch),
    "tum": Format((".txt", ".tum"), trajectories.tum),
    "csv": Format((".csv",), trajectories.table),
}
"""By the name of the option `--to`."""
