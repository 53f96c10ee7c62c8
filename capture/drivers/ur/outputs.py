"""The digital outputs of a controller of Universal Robots, through an RTDE connection of their own.

That serves both clients of the arm, and goes on when the arm's program has ended after a fault.
"""

import time
from collections.abc import Collection
from typing import Self

from koala3d.capture.drivers.errors import RigConnectionError
from koala3d.capture.drivers.ur.rtde.stream import RegistersInUse, RtdeStream

BITS = "actual_digital_output_bits"
FREQUENCY_HZ, CONFIRM_S = 125.0, 1.0
"""Of the samples that show the outputs, and how long they may take to show a change [s]."""


class DigitalOutputs:
    """The eight standard digital outputs, 0 to 7. Use as a context manager; leaving closes the connection and changes nothing."""

    def __init__(self, host: str) -> None:
        self.host = host
        self._stream: RtdeStream | None = None

    def __enter__(self) -> Self:
        """Connect. Raises RigConnectionError: nobody answers, or another program sets the outputs."""
        try:
            inputs = [["standard_digital_output_mask", "standard_digital_output"]]
            self._stream = RtdeStream(self.host, ["timestamp", BITS], inputs, FREQUENCY_HZ)
        except RegistersInUse:
            why, remedy = "another program sets them over RTDE", "end the other program that switches them"
            raise RigConnectionError("the digital outputs are in use", where=self.host, why=why, remedy=remedy) from None
        except OSError as error:
            remedy = "enable RTDE at the pendant: Settings > Security > Services"
            raise RigConnectionError(
                "the digital outputs cannot be set", where=self.host, why=str(error), remedy=remedy
            ) from None
        return self

    def __exit__(self, *exception: object) -> None:
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def set_outputs(self, on: Collection[int], off: Collection[int]) -> None:
        """Switch some outputs on and others off at the same moment; returns once the controller shows it.

        Raises RigConnectionError: it does not show it in time, or the connection is lost.
        """
        stream = self._stream
        mask, wanted = sum(1 << number for number in {*on, *off}), sum(1 << number for number in {*on})
        shown: int | None = None
        if stream is not None:
            stream.send(1, [mask, wanted])
            deadline = time.monotonic() + CONFIRM_S
            while stream.connected and time.monotonic() < deadline:
                sample = stream.newest(0.1)
                shown = shown if sample is None else int(sample[BITS])
                if sample is not None and shown is not None and shown & mask == wanted:
                    return
        why = "the connection is lost" if stream is None or not stream.connected else f"it shows {shown or 0:08b}"
        remedy = "look at the I/O tab of the pendant: the outputs must not belong to the program or to a fieldbus"
        raise RigConnectionError("the digital outputs were not switched", where=self.host, why=why, remedy=remedy)
