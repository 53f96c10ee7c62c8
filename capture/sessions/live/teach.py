"""Views that a person shows: the arm's present pose is appended to a trajectory file."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import UnreachableError
from koala3d.capture.model.trajectory import FORMAT, VERSION, Trajectory, load_trajectory
from koala3d.capture.model.viewpoints import Viewpoint
from koala3d.capture.planning import Obstacles
from koala3d.capture.planning.solutions import solve
from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.schema import read_yaml

SAME_M, SAME_RAD = 2e-3, float(np.radians(0.5))
"""Cameras that are closer see the same: a view that is that close to another one is a slip of the finger."""
DIGITS = 4
"""Of angles in degrees: a ten-thousandth moves the flange by 2 um at full reach."""
TAKEN_OVER = ("camera", "motion", "safety", "up", "object", "target", "board", "lights")
"""What a new file has from the trajectory that is open."""


class Teaching:
    """A trajectory file that grows by the poses that are shown; the names of its views are their order.

    Args:
        path: the file; it need not exist yet. An existing one is rewritten, without its comments.
        session: the trajectory that is open: a new file takes its settings.

    Raises UsageError: `path` holds something else, or a trajectory with a split, which states how many views there are.
    """

    def __init__(self, path: Path, session: Trajectory, obstacles: Obstacles) -> None:
        self.path, self.session, self.obstacles = Path(path), session, obstacles
        if self.path.exists():
            self._require_open(load_trajectory(self.path))
        elif self.path.suffix not in (".yaml", ".yml"):
            raise UsageError("is no name of a trajectory file", where=path, remedy="give one that ends in .yaml")

    def take(self, joints: NDArray[np.float64]) -> str:
        """Append the pose at (n,) joint angles [rad] as a view of the kind `joints`; returns its name.

        Raises:
            UnreachableError: the pose is too close to something, or a limit forbids it; it could not be planned.
            UsageError: a view of the file sees the same, or the file has been changed to something else meanwhile.
        """
        degrees = np.degrees(joints).round(DIGITS)
        view = Viewpoint(joints=np.radians(degrees))
        if reason := solve(view, self.obstacles).reason:
            raise UnreachableError("this pose cannot be a view", where=self.path, why=reason, remedy="move the arm a little")
        content, number = self._content(view)
        groups = content["views"]
        if groups and groups[-1].keys() == {"kind", "joints_deg"} and groups[-1]["kind"] == "joints":
            groups[-1]["joints_deg"].append(degrees.tolist())
        else:
            groups.append({"kind": "joints", "joints_deg": [degrees.tolist()]})
        Trajectory.model_validate(content)
        files.write_text(self.path, yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=130))
        return load_trajectory(self.path).viewpoints()[number].name

    def _content(self, view: Viewpoint) -> tuple[dict[str, Any], int]:
        """What the file holds, or a new one, and its number of views."""
        if not self.path.exists():
            kept = self.session.model_dump(mode="json", include=set(TAKEN_OVER), exclude_defaults=True)
            return {"format": FORMAT, "version": VERSION, "name": _name(self.path), **kept, "views": []}, 0
        found = load_trajectory(self.path)
        self._require_open(found)
        self._require_new(found, view)
        return read_yaml(self.path)[0], found.number

    def _require_open(self, found: Trajectory) -> None:
        if found.split is not None:
            why, remedy = f"it states {found.number} views", "remove 'split', or choose another file"
            raise UsageError("has a split, which another view would contradict", where=self.path, why=why, remedy=remedy)

    def _require_new(self, found: Trajectory, view: Viewpoint) -> None:
        mount = self.obstacles.carrier
        for other in found.viewpoints():
            distance, angle = map(float, pose.difference(other.camera_pose(mount), view.camera_pose(mount)))
            if distance < SAME_M and angle < SAME_RAD:
                why = f"{1e3 * distance:.1f} mm and {np.degrees(angle):.2f} degrees away"
                raise UsageError(f"view {other.name} sees the same", where=self.path, why=why, remedy="move the arm first")


def _name(path: Path) -> str:
    """A name of a trajectory from that of its file."""
    return "".join(letter if letter.isascii() and (letter.isalnum() or letter in "_.-") else "_" for letter in path.stem)
