"""A simulated controller of Universal Robots for real clients: a process of its own on a loopback address.

with SimulatedController.start(seed=0, time_scale=20.0) as simulated, UniversalRobot(simulated.host) as robot:
    robot.move_to(joints, speed=1.0, acceleration=1.4)
    simulated.true_base_from_flange()
"""

import ipaddress
import json
import os
import subprocess
import sys
import tempfile
import threading
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import SimulationError
from koala3d.capture.model.arm import DEFAULT, load_arm
from koala3d.capture.model.flaws import Flaws
from koala3d.capture.sim.controller.handle import ControllerHandle
from koala3d.datasets.core.errors import UsageError

START_TIMEOUT_S = 180.0
HOME = (0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0)  # joint angles at the start: stretched upwards [rad]
BUILT_MM, BUILT_DEG = 0.5, 0.05
"""Standard deviations of the links of an arm as built from the nominal ones; they move the flange by millimetres."""
ENCODER_NOISE_RAD = (
    Flaws().encoder_noise_rad
)  # of an arm as built: its flange seems to move by 5 um, a sixth of the repeatability


class SimulatedController(ControllerHandle):
    """The process and its side channel. Use `start`; leaving the context ends the process, and so does the end of its parent."""

    def __init__(self, process: "subprocess.Popen[bytes]", host: str, side_port: int, output: IO[bytes]) -> None:
        super().__init__(host, side_port)
        self.process, self._output, self._shown = process, output, 0

    @classmethod
    def start(
        cls,
        *,
        seed: int = 0,
        time_scale: float = 20.0,
        repeatability_mm: float = 0.03,
        repeatability_deg: float = 0.005,
        length_error_mm: float = 0.0,
        angle_error_deg: float = 0.0,
        links_seed: int | None = None,
        noise_rad: float = 0.0,
        hangs: bool = False,
        home: NDArray[np.float64] | tuple[float, ...] = HOME,
        host: str = "",
        model: str = DEFAULT,
    ) -> Self:
        """Start the process and wait until its ports accept.

        Args:
            seed: of the errors; the same seed and the same moves give the same errors.
            time_scale: how much faster than real time the controller's clock runs.
            repeatability_mm, repeatability_deg: one standard deviation per axis of where the flange really stops.
            length_error_mm, angle_error_deg: standard deviation of the links from the nominal ones; the controller knows them.
            links_seed: of the links; None: `seed`. The same one gives the same arm.
            noise_rad: standard deviation of the angles that the encoders measure.
            hangs: whether the base's z axis points to the ground.
            home: (6,) joint angles at the start [rad].
            host: loopback address; empty: a free one.
            model: which arm it is, by the name or the file of `capture.model.arm`.

        Raises:
            UsageError: `host` is no loopback address; nothing simulated listens to other computers.
            SimulationError: it did not start.
        """
        if host and not _is_loopback(host):
            raise UsageError("is no loopback address", where=host, remedy="give one of 127.0.0.1 to 127.255.255.254")
        options = {
            "host": host,
            "model": str(model),
            "seed": int(seed),
            "links_seed": int(seed if links_seed is None else links_seed),
            "time_scale": float(time_scale),
            "home": [float(angle) for angle in home],
            "repeatability_m": repeatability_mm / 1000,
            "repeatability_rad": float(np.radians(repeatability_deg)),
            "length_error_m": length_error_mm / 1000,
            "angle_error_rad": float(np.radians(angle_error_deg)),
            "noise_rad": float(noise_rad),
            "up": [0.0, 0.0, -1.0 if hangs else 1.0],
        }
        process, ready, output = _launch(options)
        if not ready:
            why = _last_line(output).removeprefix("OSError: ")
            remedy = "end the other program, or choose another --host"
            raise SimulationError("the simulated controller did not start", where=host, why=why, remedy=remedy)
        return cls(process, ready["host"], ready["side_port"], output)

    @classmethod
    def as_built(
        cls,
        *,
        seed: int,
        time_scale: float,
        links_seed: int | None = None,
        hangs: bool = False,
        host: str = "",
        model: str = DEFAULT,
        noise_rad: float = ENCODER_NOISE_RAD,
    ) -> Self:
        """`start` an arm with the links and the encoders of a real one; out of the way if it hangs."""
        errors: dict[str, Any] = {"length_error_mm": BUILT_MM, "angle_error_deg": BUILT_DEG, "noise_rad": noise_rad}
        arm = load_arm(model)
        home = arm.hanging_home if hangs else arm.home
        place: dict[str, Any] = {"host": host, "home": home, "hangs": hangs, "model": model}
        return cls.start(seed=seed, time_scale=time_scale, links_seed=links_seed, **place, **errors)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """End the process; may be called twice."""
        super().close()
        self.process.kill()
        self.process.communicate()
        self._output.close()

    def last_line(self) -> str:
        """The last line that the process printed."""
        return _last_line(self._output)

    def new_lines(self) -> list[str]:
        """What the process has said since the last call: why a program was refused or ended, line by line."""
        lines = _printed(self._output)[self._shown :].splitlines(keepends=True)
        whole = [line for line in lines if line.endswith(b"\n")]
        self._shown += sum(map(len, whole))
        return [line.decode(errors="replace").rstrip() for line in whole]


def _launch(options: dict[str, Any]) -> tuple["subprocess.Popen[bytes]", dict[str, Any], IO[bytes]]:
    """The process, what it reports once its ports accept (empty: it ended), and its error output."""
    output = tempfile.TemporaryFile()
    process = subprocess.Popen(
        [sys.executable, "-m", "koala3d.capture.sim.controller._child", json.dumps(options)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=output,
        start_new_session=True,
    )
    assert process.stdout is not None  # it is a pipe
    timer = threading.Timer(START_TIMEOUT_S, process.kill)
    timer.start()
    try:
        line = process.stdout.readline()
    finally:
        timer.cancel()
    if not line:
        process.kill()
        process.communicate()
    return process, json.loads(line or b"{}"), output


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.IPv4Address(host).is_loopback
    except ValueError:
        return False


def _last_line(output: IO[bytes]) -> str:
    if output.closed:
        return "it has been closed"
    lines = _printed(output).decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else "it printed nothing"


def _printed(output: IO[bytes]) -> bytes:
    """All that the process has printed; its place in the file, which it shares, stays where it is."""
    return os.pread(output.fileno(), os.fstat(output.fileno()).st_size, 0)
