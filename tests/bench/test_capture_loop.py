"""The measurements themselves: that they measure what they say. The figures that a machine reaches are another matter."""

import numpy as np
import pytest

from koala3d.datasets.imaging import images
from koala3d.datasets.recording import Frame
from tests.bench import capture_loop as bench


def frame(index, robot_time_s, host_s):
    return Frame(
        index=index,
        name=f"{index:03d}",
        split="train",
        image="",
        base_from_flange=np.eye(4),
        joints=np.zeros(6),
        robot_time_s=robot_time_s,
        host_time_ns=round(host_s * 1e9),
        device_ticks=0,
        exposure_us=10_000.0,
        settle_s=0.2,
        sha256="",
    )


def test_overhead_is_what_motion_settling_and_exposure_leave():
    frames = [frame(0, 100.0, 5.0), frame(1, 101.5, 6.52), frame(2, 104.5, 9.6)]
    motions = np.array([[99.0, 0.8, 0.1], [100.01, 1.1, 0.15], [101.6, 1.0, 0.1], [103.0, 1.0, 0.1]])
    # 1.52 s less 1.1 + 0.15 + 0.2 + 0.01; 3.08 s less two motions of 1.1 + 0.2, and 0.01
    np.testing.assert_allclose(bench._overheads(frames, motions, 0.2), [0.06, 0.47], atol=1e-9)


def test_states_are_counted_in_the_controllers_time():
    assert 40 < bench.state_rate(1.2, frequency=100.0) < 115  # fewer on a busy computer, never many more


@pytest.mark.slow
def test_an_early_exposure_is_blurred_and_a_late_one_is_not(tmp_path):
    points = bench.settle_curve((0.0, 0.02, 0.5), repeats=2)
    assert min(points[0].sharpness, points[1].sharpness) < 0.95 < points[2].sharpness
    assert points[0].off_mm > 2 * points[2].off_mm and points[2].off_mm < 0.25  # repeatability alone
    bench.plot_settling(points, tmp_path / "settling.png")
    assert images.size(tmp_path / "settling.png")[0] > 500


@pytest.mark.slow
def test_the_loop_costs_little_beside_motion_settling_and_exposure():
    assert 0 < np.median(bench.loop_overhead(6)) < 0.1  # 0.02 on an idle computer


def test_the_summary_is_printed_line_by_line():
    points = [bench.SettlePoint(0.02, 0.755, 0.1234), bench.SettlePoint(0.5, 1.0, 0.01)]
    found = bench.summary(points, np.array([0.020, 0.030, 0.100]), 499.6)
    assert found["overhead_ms"] == {"median": pytest.approx(30), "worst": pytest.approx(100), "frames": 4}
    assert bench.lines(found) == [
        "states: 500 Hz",
        "overhead: median 30.0 ms, worst 100.0 ms",
        "delay of the exposure after the motion:",
        "     20 ms: sharpness  75.5 %, camera off by 0.123 mm",
        "    500 ms: sharpness 100.0 %, camera off by 0.010 mm",
    ]
