import time

import numpy as np
import pytest

from koala3d.capture.drivers.errors import MotionError, NotReady, RigConnectionError, SafetyError, StopLatched
from koala3d.capture.drivers.turntable.grbl import GrblTurntable
from koala3d.capture.model.shapes.geometry import PoseDescription
from koala3d.capture.model.turntable import TurntableDescription
from koala3d.capture.sim.grbl import SimulatedGrbl
from tests.moments import as_soon_as

STEP_RAD = np.radians(1 / 80)  # of the simulated motor


def table_at(address: str, **changes) -> TurntableDescription:
    plain = {"base_from_turntable": PoseDescription(position=(0.4, 0.0, 0.0)), "settle_time_s": 0.0, "max_speed": 2.0}
    return TurntableDescription(address=address, **(plain | changes))


@pytest.mark.parametrize("terminal", [False, True], ids=["network", "serial"])
def test_turns_where_it_is_told_and_reports_it(terminal):
    with SimulatedGrbl(time_scale=50, terminal=terminal) as controller:
        with GrblTurntable(table_at(controller.address)) as table:
            assert table.angle() == 0.0
            for angle in (np.radians(90), np.radians(-30.5), 2 * np.pi):
                table.turn_to(angle)
                assert table.angle() == pytest.approx(angle, abs=STEP_RAD)
                assert controller.place == pytest.approx(np.degrees(angle), abs=1 / 80)
            assert table.description()["version"].startswith("[VER:1.1h")
        assert controller.place == 0.0  # it went back: a controller that starts again takes its place for zero


def test_a_reversed_table_and_other_units():
    with SimulatedGrbl(time_scale=50) as controller:
        with GrblTurntable(table_at(controller.address, reversed=True, units_per_turn=36.0)) as table:
            table.turn_to(np.pi / 2)
            assert controller.place == pytest.approx(-9.0, abs=1 / 80) and table.angle() == pytest.approx(np.pi / 2, abs=0.01)


def test_motion_takes_its_time_and_speed_is_kept():
    with SimulatedGrbl(time_scale=10) as controller, GrblTurntable(table_at(controller.address, max_speed=1.0)) as table:
        begun = time.monotonic()
        table.turn_to(np.pi)
        assert time.monotonic() - begun > np.pi / 10  # a table that arrives sooner was faster than allowed


def test_angles_beyond_the_limits_are_refused_and_nothing_turns():
    with SimulatedGrbl(time_scale=50) as controller:
        with GrblTurntable(table_at(controller.address, max_deg=170.0)) as table:
            with pytest.raises(SafetyError, match=r"turntable angle 180.0 degrees, limits -3600 to 170"):
                table.turn_to(np.pi)
            assert controller.place == 0.0


def test_stop_from_another_thread_ends_the_motion_and_holds(monkeypatch):
    with SimulatedGrbl(time_scale=1) as controller, GrblTurntable(table_at(controller.address, max_speed=0.2)) as table:
        with as_soon_as(lambda: controller.place > 0, table.stop, "a table that turns"):
            with pytest.raises(MotionError, match="stopped on request"):
                table.turn_to(np.pi)
        table.angle()  # the controller has answered, and read everything before
        rest = controller.place
        assert 0 < rest < 180
        monkeypatch.setattr(table._wire, "send", lambda words: pytest.fail(f"sent {words}"))
        with pytest.raises(StopLatched):
            table.turn_to(0.0)
        assert controller.place == rest


def test_after_an_error_the_table_is_left_where_it_stands(capfd):
    with SimulatedGrbl(time_scale=50) as controller:
        with pytest.raises(RuntimeError), GrblTurntable(table_at(controller.address)) as table:
            table.turn_to(1.0)
            raise RuntimeError
        assert controller.place == pytest.approx(np.degrees(1.0), abs=1 / 80)
        assert "turn it to its mark before --resume" in capfd.readouterr().err
        with GrblTurntable(table_at(controller.address)) as table:  # may be connected again
            assert table.angle() == pytest.approx(1.0, abs=STEP_RAD)


def test_an_alarm_is_refused_and_homing_ends_it():
    with SimulatedGrbl(time_scale=50, state="Alarm") as controller:
        with pytest.raises(NotReady, match="state Alarm"), GrblTurntable(table_at(controller.address)):
            pass
        with GrblTurntable(table_at(controller.address, homing=True)) as table:
            assert table.angle() == 0.0


def test_a_blocked_table_is_reported(monkeypatch):
    monkeypatch.setattr("koala3d.capture.drivers.turntable.grbl.SPARE_S", 0.1)
    with SimulatedGrbl(time_scale=50) as controller:
        with pytest.raises(MotionError, match=r"does not arrive.*57.30 from its target"):
            with GrblTurntable(table_at(controller.address, max_speed=20.0)) as table:
                controller.stuck = True
                table.turn_to(1.0)


def test_a_silent_controller_is_reported(monkeypatch):
    with SimulatedGrbl(time_scale=50) as controller:
        with pytest.raises(RigConnectionError, match="went silent"), GrblTurntable(table_at(controller.address)) as table:
            controller.silent = True
            monkeypatch.setattr("koala3d.capture.drivers.turntable.grbl.ANSWER_S", 0.1)
            table.turn_to(1.0)
        monkeypatch.setattr("koala3d.capture.drivers.turntable.grbl.AWAKE_S", 0.3)
        with pytest.raises(RigConnectionError, match="does not answer"), GrblTurntable(table_at(controller.address)):
            pass


def test_an_address_without_a_table_is_named(tmp_path):
    for address, why in (("/dev/koala-missing", "No such file"), ("127.0.0.1:1", "refused")):
        with pytest.raises(RigConnectionError, match=rf"{address}.*{why}"), GrblTurntable(table_at(address)):
            pass
    (tmp_path / "file").write_text("")
    with pytest.raises(RigConnectionError, match="not a serial port"), GrblTurntable(table_at(str(tmp_path / "file"))):
        pass
