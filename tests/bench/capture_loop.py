"""Benchmarks of the capture loop on the simulated rig: sharpness against settling time, loop overhead, rate of robot states.

    python -m tests.bench.capture_loop bench

They use the vendors' clients against a simulated controller in real time, and write bench/bench.json and bench/settling.png.
"""

import argparse
import itertools
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.cameras.basler import Basler
from koala3d.capture.drivers.ur.link import Deadlines
from koala3d.capture.drivers.ur.robot import UniversalRobot
from koala3d.capture.drivers.ur.settling import Settling
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.planning import plan
from koala3d.capture.recording.focus import sharpness
from koala3d.capture.recording.recorder import record
from koala3d.capture.rig.rig import Rig
from koala3d.capture.sim.camera import SimulatedCamera
from koala3d.capture.sim.controller.process import SimulatedController
from koala3d.capture.sim.truth import RigTruth
from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.recording import Frame

DELAYS_S = (0.0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.13, 0.16, 0.2, 0.25, 0.3, 0.4, 0.5)
"""Waits between the end of a motion and the exposure."""
PATIENT = Deadlines(stale_s=1.0, watchdog_hz=1.0)  # long deadlines: a busy computer must not count as a fault of the rig


@dataclass(frozen=True)
class SettlePoint:
    """Mean result of one waiting time after a motion, over several motions."""

    delay_s: float  # from the end of the motion to the exposure, as measured
    sharpness: float  # of the picture, relative to a picture of the arm at rest
    off_mm: float  # distance of the camera from its resting place


def state_rate(seconds: float = 2.0, *, frequency: float = 500.0) -> float:
    """Rate of distinct states that the driver receives from a moving arm [Hz]."""
    with SimulatedController.start(time_scale=1.0) as controller:
        with UniversalRobot(controller.host, deadlines=PATIENT, frequency=frequency, settling=Settling(time_s=0.0)) as robot:
            start = robot.state().joints
            speed, acceleration = 0.5, 1.4
            turn = speed * (seconds - speed / acceleration)
            begun, first = controller.ask("truth")["robot_time_s"], robot.states_received
            robot.move_to(start + np.eye(6)[0] * turn, speed=speed, acceleration=acceleration)
            return (robot.states_received - first) / (controller.ask("truth")["robot_time_s"] - begun)


def loop_overhead(count: int = 12) -> NDArray[np.float64]:
    """(count - 1,) time between frames beyond motion, swing, settling and exposure, at the sensor's full resolution [s]."""
    trajectory = load_trajectory("koala", overrides=["motion.settle_time_s=0.2"])
    description = RigDescription()
    planned = plan(trajectory, description.carrier())[:count]
    motion = trajectory.motion
    settling = Settling(motion.settle_spread, motion.settle_time_s, 20.0)
    with TemporaryDirectory(prefix="koala-bench-") as folder, SimulatedController.start(time_scale=1.0) as controller:
        with Basler(trajectory.camera, emulated=True) as camera:
            with UniversalRobot(controller.host, deadlines=PATIENT, settling=settling) as robot:
                rig = Rig(robot, camera, description, "bench")
                frames = record(trajectory, rig, Path(folder) / "recording", planned=planned).frames
                motions = controller.ask("motions", settle_spread=motion.settle_spread)["motions"]
    return _overheads(frames, np.array(motions), motion.settle_time_s)


def _overheads(frames: list[Frame], motions: NDArray[np.float64], settle_time_s: float) -> NDArray[np.float64]:
    """See `loop_overhead`; `motions` are (n, 3): start, duration, swing [s of the controller's clock]."""
    overheads = []
    for before, frame in itertools.pairwise(frames):
        between = (motions[:, 0] > before.robot_time_s) & (motions[:, 0] < frame.robot_time_s)
        needed = motions[between, 1:].sum() + between.sum() * settle_time_s + frame.exposure_us * 1e-6
        overheads.append((frame.host_time_ns - before.host_time_ns) * 1e-9 - needed)
    return np.array(overheads)


def settle_curve(
    delays_s: tuple[float, ...] = DELAYS_S,
    *,
    exposure_us: float = 20_000.0,
    repeats: int = 2,
) -> list[SettlePoint]:
    """Sharpness of a picture of the board, and position error of the camera, against the wait after a motion."""
    small = ["camera.binning=1", "camera.width=320", "camera.height=240", f"camera.exposure_us={exposure_us}"]
    trajectory = load_trajectory("calibration_demo", overrides=small)
    description = RigDescription()
    mount = description.flange_from_camera.matrix()
    target, motion = plan(trajectory, description.carrier())[0].joints, trajectory.motion
    starts = [target + 0.25 * np.where(np.arange(6) % 2, 1, -1) * (-1) ** turn for turn in range(repeats)]
    points = []
    with SimulatedController.start(time_scale=1.0) as controller:
        camera = SimulatedCamera(trajectory, "board", RigTruth.draw(mount, 0), controller, 0)
        with camera, UniversalRobot(controller.host, deadlines=PATIENT) as robot:

            def look(start: NDArray[np.float64], delay_s: float) -> tuple[float, float, NDArray[np.float64]]:
                for joints, wait_s in ((start, 0.0), (target, delay_s)):
                    robot.settling = Settling(np.inf, wait_s)  # any spread counts as still: only the wait matters
                    robot.move_to(joints, speed=motion.speed, acceleration=motion.acceleration)
                truth = controller.ask("truth")
                image = camera.grab()
                return truth["phase_s"] - truth["motion_s"], sharpness(image.pixels), camera.base_from_camera

            still = [look(start, 1.0) for start in starts]
            for delay_s in delays_s:
                seen = []
                for start, (_, sharp, rest) in zip(starts, still, strict=True):
                    since, moving, place = look(start, delay_s)
                    seen.append((since, moving / sharp, 1e3 * float(pose.difference(place, rest)[0])))
                points.append(SettlePoint(*map(float, np.mean(seen, axis=0))))
    return points


def plot_settling(points: list[SettlePoint], path: Path) -> None:
    """Draw `settle_curve`'s result."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    delays = [1e3 * point.delay_s for point in points]
    figure, left = pyplot.subplots(figsize=(7, 4), layout="constrained")
    left.plot(delays, [100 * point.sharpness for point in points], "o-", color="tab:blue")
    left.set(xlabel="wait after the motion [ms]", ylabel="sharpness [% of that at rest]", ylim=(0, 110))
    left.yaxis.label.set_color("tab:blue")
    right = left.twinx()
    right.plot(delays, [point.off_mm for point in points], "s--", color="tab:red")
    right.set(ylabel="camera off its resting place [mm]", ylim=(0, None))
    right.yaxis.label.set_color("tab:red")
    left.grid(alpha=0.3)
    with files.atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=120)
    pyplot.close(figure)


def summary(points: list[SettlePoint], overheads: NDArray[np.float64], rate_hz: float) -> dict[str, Any]:
    """All results as one plain dictionary."""
    ms = 1e3 * overheads
    return {
        "state_rate_hz": round(rate_hz, 1),
        "overhead_ms": {"median": float(np.median(ms)), "worst": float(ms.max()), "frames": len(ms) + 1},
        "settling": [vars(point) for point in points],
    }


def lines(found: dict[str, Any]) -> list[str]:
    """`summary` as text, line by line."""
    median, worst = found["overhead_ms"]["median"], found["overhead_ms"]["worst"]
    states, overhead = f"states: {found['state_rate_hz']:.0f} Hz", f"overhead: median {median:.1f} ms, worst {worst:.1f} ms"
    line = "  {:5.0f} ms: sharpness {:5.1f} %, camera off by {:.3f} mm"
    points = [line.format(1e3 * one["delay_s"], 100 * one["sharpness"], one["off_mm"]) for one in found["settling"]]
    return [states, overhead, "delay of the exposure after the motion:", *points]


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, metavar="FOLDER", help="new folder")
    parser.add_argument("--frames", type=int, default=12, help="frames to measure the overhead of the loop with")
    asked = parser.parse_args()
    files.refuse_existing(asked.out)
    points = settle_curve()
    found = summary(points, loop_overhead(asked.frames), state_rate())
    with files.atomic_folder(asked.out) as folder:
        files.write_json(folder / "bench.json", found)
        plot_settling(points, folder / "settling.png")
    print("\n".join(lines(found)))


if __name__ == "__main__":
    main()
