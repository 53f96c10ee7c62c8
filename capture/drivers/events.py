"""What happens to a rig, told to whoever keeps a log of the session: see `capture.recording.session_log`."""

import logging
from typing import Any

EVENTS = logging.getLogger("koala3d.events")
EVENTS.setLevel(logging.INFO)
EVENTS.propagate = False  # a person sees warnings, and not each order to the arm
EVENTS.addHandler(logging.NullHandler())


def event(name: str, /, **facts: Any) -> None:
    """Tell that something happened: a word for it, and what JSON can hold about it. May be called from any thread."""
    EVENTS.info(name, extra={"facts": facts})
