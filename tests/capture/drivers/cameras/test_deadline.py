import threading
import time

import pytest

from koala3d.capture.drivers.cameras.deadline import Patient
from koala3d.capture.drivers.errors import RigConnectionError


def test_results_and_errors_come_back():
    patient = Patient("camera 7")
    assert patient.call(5.0, lambda a, b: a + b, 2, 3) == 5
    with pytest.raises(ZeroDivisionError):
        patient.call(5.0, lambda: 1 // 0)
    assert patient.call(5.0, threading.get_ident) != threading.get_ident()
    patient.end()
    patient.end()


def test_a_call_that_hangs_is_left_and_no_other_takes_its_result():
    patient, gate = Patient("camera 7"), threading.Event()
    begun = time.monotonic()
    with pytest.raises(RigConnectionError, match=r"camera 7: camera does not answer \(nothing within 0.1 s\); unplug"):
        patient.call(0.1, gate.wait)
    assert time.monotonic() - begun < 3
    gate.set()
    with pytest.raises(RigConnectionError, match="it was late before"):
        patient.call(5.0, lambda: "new")
    patient.end()
