"""A connection to the side channel of a simulated controller.

handle = ControllerHandle(host, side_port)
handle.true_base_from_flange()
handle.ask("joint_limit", joint=2, upper_deg=-60)
"""

import json
import socket
import threading
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.capture.drivers.errors import SimulationError

REPLY_TIMEOUT_S = 5.0


class ControllerHandle:
    """One connection to the side channel; opened at the first request, `close` may be called twice. Any thread may ask."""

    def __init__(self, host: str, side_port: int) -> None:
        self.host, self.side_port = host, side_port
        self._lock = threading.Lock()
        self._side: socket.socket | None = None

    def close(self) -> None:
        """Close the connection; the controller keeps running."""
        if self._side is not None:
            self._side.close()
            self._side = None

    def true_base_from_flange(self) -> NDArray[np.float64]:
        """(4, 4) where the flange really is now [m]; for the simulated camera and for evaluation only."""
        return np.array(self.ask("truth")["base_from_flange"])

    def exposed(self, exposure_s: float, count: int) -> NDArray[np.float64]:
        """(count, 4, 4) where the flange really is during an exposure that begins now [m]."""
        return np.array(self.ask("truth", exposure_s=exposure_s, count=count)["exposed"])

    def push(self, joints: ArrayLike) -> None:
        """Move the arm by hand to (6,) joint angles [rad]; returns at once. It must be in freedrive."""
        self.ask("push", joints=np.asarray(joints, np.float64).tolist())

    def signals(self) -> dict[str, Any]:
        """The electrical outputs; bits of `digital` as in `actual_digital_output_bits`."""
        return self.ask("signals")

    def ask(self, do: str, **arguments: Any) -> dict[str, Any]:
        """Send one request to the side channel and return its reply; `capture.sim.controller.side_channel.ACTIONS` lists them.

        Raises SimulationError: the controller has ended, or does not know the request.
        """
        with self._lock:
            try:
                if self._side is None:
                    self._side = socket.create_connection(("127.0.0.1", self.side_port), REPLY_TIMEOUT_S)
                self._side.sendall((json.dumps({"do": do, **arguments}) + "\n").encode())
                reply = b""
                while not reply.endswith(b"\n"):
                    chunk = self._side.recv(65536)
                    if not chunk:
                        raise ConnectionError("it closed the connection")
                    reply += chunk
            except OSError as error:
                self.close()
                why = f"{error}. {self.last_line()}"
                raise SimulationError("the simulated controller does not answer", why=why, remedy="start it again") from None
        content: dict[str, Any] = json.loads(reply)
        if "error" in content:
            raise SimulationError("the simulated controller refused a request", where=do, why=content["error"])
        return content

    def last_line(self) -> str:
        """The last line that its process printed; empty where that is unknown."""
        return ""
