"""The links of an arm as it was built: those that its controller reports, and a copy beside the rig file, for plans without it.

For `my_rig.yaml` the copy is `my_rig.links.json`. `capture doctor` writes it.
"""

import logging
from pathlib import Path
from typing import Any

from koala3d import configs
from koala3d.capture.drivers.ur.interfaces.primary import listen
from koala3d.capture.model.built import BuiltArm
from koala3d.capture.model.rig import RigDescription
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.kinematics import Links

log = logging.getLogger(__name__)
FORMAT, VERSION = "koala-links", 1


def reported_links(description: RigDescription, host: str) -> Links | None:
    """The calibrated links that the controller at `host` reports; None, with a warning, where it says none.

    Arms of other makers have no controller that Koala speaks to. Raises UsageError: they are those of another model.
    """
    found = _links(description, host)
    if found is None and description.arm.family == "ur":
        nominal = f"plans use the nominal ones of the {description.arm.name}"
        log.warning("%s does not say its calibrated links: %s, from which a real arm differs by millimetres", host, nominal)
    return None if found is None else BuiltArm(description.arm, found).links


def _links(description: RigDescription, host: str) -> Links | None:
    try:
        return listen(host).links if description.arm.family == "ur" else None
    except (OSError, ValueError):  # nobody answers, or it is no primary interface
        return None


def links_path(rig: str) -> Path | None:
    """Where the links of a rig are kept; None for one that is no file of the user's."""
    path = Path(rig)
    mine = (
        path.suffix in (".yaml", ".yml") and path.is_file() and not path.resolve().is_relative_to(Path(configs.__file__).parent)
    )
    return path.with_suffix(".links.json") if mine else None


def store_links(rig: str, description: RigDescription, host: str) -> Path | None:
    """Write the links that the controller reports beside the rig file; None if it reports none, or the rig is no such file."""
    path = links_path(rig)
    links = None if path is None else _links(description, host)
    if path is None or links is None:
        return None
    try:
        links = BuiltArm(description.arm, links).links
    except UsageError:  # of another model, which the doctor says
        return None
    content = {"format": FORMAT, "version": VERSION, "model": description.arm.name, "links": links.to_json()}
    files.write_json(path, content)
    return path


def stored_links(rig: str, description: RigDescription) -> Links | None:
    """The links that are kept beside a rig file; None where none are. Raises UsageError: they are those of another model."""
    path = links_path(rig)
    if path is None or not path.is_file():
        return None
    content: dict[str, Any] = files.read_json(path)
    if content.get("format") != FORMAT or content.get("version") != VERSION:
        remedy = "remove it; 'capture doctor' writes a new one"
        raise UsageError(f"is not a {FORMAT} file of version {VERSION}", where=path, remedy=remedy)
    return BuiltArm(description.arm, Links.from_json(content.get("links"), where=path)).links
