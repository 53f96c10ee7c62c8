"""Deadlines for vendors' calls that have none of their own: a webcam that was unplugged blocks its reader for ever."""

import queue
import threading
from collections.abc import Callable
from typing import Any, TypeVar

from koala3d.capture.drivers.cameras.base import CameraDriver
from koala3d.capture.drivers.errors import RigConnectionError
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings

Result = TypeVar("Result")
REMEDY = "unplug the camera, plug it in again, and continue with --resume"


class Patient:
    """Calls functions in a thread of its own, one at a time, and waits for each no longer than its deadline.

    The result of a late call is never used, since it would belong to an earlier picture. From then on calls are refused.
    The thread is a daemon, so that a call that never returns does not keep the program alive.
    """

    def __init__(self, where: str) -> None:
        self.where, self._lost = where, False
        self._asked: queue.Queue[Callable[[], Any] | None] = queue.Queue()
        self._answers: queue.Queue[tuple[Any, BaseException | None]] = queue.Queue()
        threading.Thread(target=self._work, name=where, daemon=True).start()

    def call(self, seconds: float, function: Callable[..., Result], *arguments: Any) -> Result:
        """The result of a call, or what it raises. Raises RigConnectionError: it took longer than `seconds`, now or before."""
        if self._lost:
            raise RigConnectionError("camera does not answer", where=self.where, why="it was late before", remedy=REMEDY)
        self._asked.put(lambda: function(*arguments))
        try:
            result, error = self._answers.get(timeout=seconds)
        except queue.Empty:
            self._lost = True
            why = f"nothing within {seconds:.1f} s"
            raise RigConnectionError("camera does not answer", where=self.where, why=why, remedy=REMEDY) from None
        if error is not None:
            raise error
        return result

    def end(self) -> None:
        """Let the thread end after the call that runs. May be called twice."""
        self._asked.put(None)

    def end_after(self, seconds: float, release: Callable[[], Any]) -> None:
        """Let go of the device by a last call, then end. A call that hangs is left to its thread."""
        try:
            self.call(seconds, release)
        except RigConnectionError:
            pass
        self.end()

    def _work(self) -> None:
        while (act := self._asked.get()) is not None:
            try:
                self._answers.put((act(), None))
            except BaseException as error:  # raised in the thread that waits
                self._answers.put((None, error))


class PatientCamera(CameraDriver):
    """A driver whose library waits for ever: its calls have deadlines."""

    open_s, set_up_s, answer_s = 20.0, 20.0, 10.0
    """Longest time to open, to write all settings, and for another answer [s]."""

    def __init__(self, settings: CameraSettings, device: Device) -> None:
        super().__init__(settings, device)
        self._patient: Patient | None = None

    def _begin(self) -> None:
        self._patient = Patient(self.name)
        self._patient.call(self.open_s, self._connect)
        self._patient.call(self.set_up_s, self._configure)

    def _configure(self) -> None:
        """Write the settings."""
        raise NotImplementedError

    def _release(self, camera: object) -> None:
        """Let go of the library's own object."""
        raise NotImplementedError

    def _call(self, seconds: float, function: Callable[..., Result], *arguments: Any) -> Result:
        """See `Patient.call`; the camera must be open."""
        self._require_open()
        assert self._patient is not None  # it is open
        return self._patient.call(seconds, function, *arguments)

    def _close(self) -> None:
        patient, camera = self._patient, self._camera
        self._patient, self._camera = None, None
        if patient is None and camera is not None:  # it was only looked at
            self._release(camera)
        elif patient is not None and camera is not None:
            patient.end_after(self.answer_s, lambda: self._release(camera))
        elif patient is not None:
            patient.end()
