"""What a session does by itself about a fault: it leaves a view out, or connects again. The manifest keeps that it did."""

import logging
import time
from collections.abc import Sequence
from datetime import datetime

from koala3d.capture.drivers.errors import CaptureError, ConnectionLapse, NotSettled
from koala3d.capture.rig.rig import Rig
from koala3d.datasets.core import files
from koala3d.datasets.incidents import INCIDENTS, LEFT_OUT
from koala3d.datasets.recording import MANIFEST, Recording

log = logging.getLogger(__name__)
CONNECTED_AGAIN = "connected again"
PAUSE_S = 1.0  # before connecting again: what made the stream hiccup may need a moment
IDENTITY = ("model", "serial", "tcp_offset")


class Incidents:
    """Those of one session, in the recordings of all its cameras."""

    def __init__(self, recordings: Sequence[Recording], rig: Rig) -> None:
        self.recordings, self.robot = recordings, rig.robot
        self._is_second = False

    def leave_out(self, view: str, error: NotSettled) -> None:
        """Keep that a view was not taken, and why."""
        log.warning("view %s is left out, --resume takes it: %s", view, error)
        self._keep(view, LEFT_OUT, error)

    def connect_again(self, view: str, lapse: ConnectionLapse) -> None:
        """Enter the arm once more, and keep that. Raises the lapse itself if it is the session's second, or that fails.

        Entering checks safety, power and control, and that no other program runs.
        """
        if self._is_second:
            raise lapse
        self._is_second = True
        before = self.robot.description()
        time.sleep(PAUSE_S)
        try:
            self.robot.__enter__()
            now = self.robot.description()
            if changed := [key for key in IDENTITY if now.get(key) != before.get(key)]:
                raise CaptureError(f"the arm has another {' and '.join(changed)} than before")
        except CaptureError as error:
            why = "; ".join(filter(None, (lapse.why, f"connecting again failed: {error.what}")))
            raise ConnectionLapse(lapse.what, where=lapse.where, why=why, remedy=lapse.remedy) from error
        log.warning("view %s: %s; connected again, and the next move is slow", view, lapse)
        self._keep(view, CONNECTED_AGAIN, lapse)

    def _keep(self, view: str, what: str, error: CaptureError) -> None:
        now = datetime.now().astimezone().isoformat(timespec="seconds")
        entry = {"view": view, "what": what, "why": str(error), "time": now}
        for recording in self.recordings:
            recording.manifest[INCIDENTS] = [*recording.manifest.get(INCIDENTS, []), entry]
            files.write_json(recording.path / MANIFEST, recording.manifest)
