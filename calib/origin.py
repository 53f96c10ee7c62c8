"""Where a calibration comes from."""

from pathlib import Path

from koala3d.datasets.bags import recorded
from koala3d.datasets.bags.reading import is_bag
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core.errors import UsageError


def recording_of(calibration: Calibration, given: Path | None) -> Path:
    """Folder that a calibration was made from, or that of its ROS bag. Raises UsageError where it is unknown or missing."""
    path = given or Path(calibration.provenance.get("recording") or calibration.provenance.get("folder", ""))
    if not (path.is_dir() or is_bag(path)) or path == Path():
        where = path if path != Path() else "calibration"
        remedy = "give the folder as --recording"
        raise UsageError("the recording is missing", where=where, why="its views are needed", remedy=remedy)
    return recorded.recording_of(path)
