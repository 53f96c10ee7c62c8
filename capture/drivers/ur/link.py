"""The parent's end of the child process that holds the client of the controller."""

import json
import socket
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from typing import IO, Any, Self


@dataclass(frozen=True)
class Deadlines:
    """How long to wait, on the host's clock."""

    stale_s: float = 0.2  # without a new sample for this long, the data stream counts as stopped [s]
    watchdog_hz: float = 5.0  # the controller stops its program when it receives nothing for one period [Hz]
    accept_s: float = 2.0  # until the controller accepts a motion [s]
    connect_s: float = 15.0  # until the control program runs [s]


@dataclass(frozen=True)
class Sample:
    """One state as the child sent it, and when it arrived (monotonic host clock [s])."""

    content: dict[str, Any]
    arrived_s: float


class ChildLink:
    """The running child: its newest state, how many came (`samples`), its answers, and the ways to end it."""

    def __init__(self, process: "subprocess.Popen[bytes]", link: socket.socket, output: IO[bytes]) -> None:
        self.process, self.link, self._output = process, link, output
        self._news = threading.Condition()
        self._sending = threading.Lock()
        self._sample: Sample | None = None
        self.samples = 0
        self._answers: list[dict[str, Any]] = []
        self._number = 0
        self._closed = False
        self._reader = threading.Thread(target=self._read, name="robot states", daemon=True)
        self._reader.start()

    @classmethod
    def start(cls, client: str, host: str, frequency: float, watchdog_hz: float, registers: str) -> Self:
        """Start the child; it connects on its own and answers "ready" or "failed"."""
        ours, theirs = socket.socketpair()
        output = tempfile.TemporaryFile()
        options = json.dumps(
            {"choice": client, "host": host, "frequency": frequency, "watchdog_hz": watchdog_hz, "registers": registers}
        )
        with theirs:
            process = subprocess.Popen(
                [sys.executable, "-m", "koala3d.capture.drivers.ur._child", str(theirs.fileno()), options],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
            )
        return cls(process, ours, output)

    @property
    def alive(self) -> bool:
        """Whether the child still runs and its socket is open."""
        return not self._closed and self.process.poll() is None

    def request(self, do: str, **arguments: Any) -> int:
        """Send a request; returns its number for `wait_for`, or 0 where the child has ended or does not listen."""
        with self._sending:
            self._number += 1
            message = json.dumps({"do": do, "number": self._number, **arguments}) + "\n"
            try:
                self.link.sendall(message.encode())
            except OSError:
                return 0
            return self._number

    def wait_for(self, kinds: tuple[str, ...], timeout_s: float, *, number: int | None = None) -> dict[str, Any] | None:
        """The first answer of one of the `kinds` (and, where given, to the request `number`); None: none came in time."""
        deadline = time.monotonic() + timeout_s
        with self._news:
            while True:
                for answer in self._answers:
                    if any(kind in answer and number in (None, answer[kind]) for kind in kinds):
                        self._answers.remove(answer)
                        return answer
                left = deadline - time.monotonic()
                if left <= 0 or self._closed:
                    return None
                self._news.wait(left)

    def next_sample(self, previous: Sample | None, timeout_s: float) -> Sample | None:
        """A sample that is not `previous`; None: none came in time."""
        with self._news:
            self._news.wait_for(lambda: self._sample is not previous or self._closed, timeout_s)
            return self._sample if self._sample is not previous else None

    def watched(self, seconds: float, count: int) -> list[list[float]]:
        """Joint angles [rad] of the samples in a time, up to three times as long if there are fewer than `count`."""
        self.request("watch")
        begun, sample, joints = time.monotonic(), self._sample, []
        while (since := time.monotonic() - begun) < seconds or (len(joints) < count and since < 3 * seconds):
            if (newer := self.next_sample(sample, seconds)) is not None:
                sample = newer
                joints.append(newer.content["joints"])
        return joints

    @property
    def newest(self) -> Sample | None:
        """The newest sample, however old; None: there was none."""
        return self._sample

    def fresh_sample(self, age_s: float, timeout_s: float, *, newer_than_ns: int = 0) -> Sample | None:
        """A sample younger than `age_s` and newer than a time of the host's clock [ns]; None: none came in time."""
        deadline = time.monotonic() + timeout_s
        while True:
            sample = self._sample
            at_ns = sample.content["host_time_ns"] if sample is not None else 0
            if sample is not None and time.monotonic() - at_ns / 1e9 < age_s and at_ns > newer_than_ns:
                return sample
            left = deadline - time.monotonic()
            if left <= 0 or self._closed:
                return None
            self.next_sample(sample, left)

    def close(self) -> None:
        """Let the child slow the arm down and end; kill it after a second."""
        try:
            self.link.shutdown(socket.SHUT_RDWR)
        except OSError:
            pass  # it has ended already
        try:
            self.process.wait(1.0)
        except subprocess.TimeoutExpired:
            pass  # it hangs in the vendor's library
        self.kill()

    def kill(self) -> str:
        """End the child at once; returns the last line that it printed."""
        self.process.kill()
        self.process.wait()
        self._reader.join(1.0)
        self.link.close()
        if self._output.closed:
            return ""
        self._output.seek(0)
        lines = self._output.read().decode(errors="replace").strip().splitlines()
        self._output.close()
        return lines[-1].strip() if lines else ""

    def _read(self) -> None:
        buffer = b""
        while True:
            try:
                chunk = self.link.recv(65536)
            except OSError:
                chunk = b""
            arrived = time.monotonic()
            *lines, buffer = (buffer + chunk).split(b"\n")
            with self._news:
                for line in lines:
                    message = json.loads(line)
                    if "state" in message:
                        self._sample, self.samples = Sample(message["state"], arrived), self.samples + 1
                    else:
                        self._answers.append(message)
                self._closed = not chunk
                self._news.notify_all()
            if not chunk:
                return
