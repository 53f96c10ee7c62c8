"""Colour errors of a simulated grey card at four brightnesses, through the files of a recording, with and without correction.

python -m tests.bench.colour --set camera.width=480 --set camera.height=270 --set camera.pixel_format=bayer12
"""

import argparse
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.protocols import Camera
from koala3d.capture.model.trajectory import Trajectory, load_trajectory
from koala3d.capture.recording.writer import Writer
from koala3d.capture.rig.cameras import camera_for
from koala3d.capture.sessions.live.flat import measured, statistics
from koala3d.capture.sim.camera import SimulatedCamera
from koala3d.capture.sim.laboratory.scenes import CARDS
from koala3d.datasets.building.develop import develop
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images
from koala3d.datasets.radiometry.response import Response
from koala3d.datasets.recording import RADIOMETRY, Frame, Recording

EXPOSURES = (1.0, 0.5, 0.2, 0.05)
"""Exposure times of the card's pictures, relative to the trajectory's."""
BLOCKS = 6
"""The picture is compared in BLOCKS x BLOCKS parts."""


@dataclass(frozen=True)
class CardError:
    """How far a picture of a grey card is from evenly grey, and from its true light."""

    light: float  # true light of the card, 1 is white
    colour: float  # largest difference of a channel from the mean of the channels, relative
    colour_before: float  # the same without correction
    uneven: float  # largest difference of a part of the picture from its mean, relative
    uneven_before: float
    level: float  # mean of the picture relative to the true light


def errors(trajectory: Trajectory, rig: str, frames: int) -> list[CardError]:
    """Measure the response with a seed, then take pictures of the card at several brightnesses."""
    found = []
    with camera_for(rig, trajectory, scene="lens_cap", flat=Path(RADIOMETRY)) as covered:
        dark = statistics(covered, frames, nothing)
    with (
        camera_for(rig, trajectory, scene="grey_card", flat=Path(RADIOMETRY)) as camera,
        TemporaryDirectory(prefix="koala-colour-") as folder,
    ):
        if not isinstance(camera, SimulatedCamera):
            raise UsageError("only a simulated rig knows the true light", where=rig, remedy="use --rig sim_flawed")
        response = measured(camera.description(), dark, statistics(camera, frames, nothing))
        response.save(Path(folder) / RADIOMETRY)
        recording = Recording.create(Path(folder) / "recording", {"camera": camera.description()})
        taken_us = []  # in the camera's own steps
        with Writer([recording], lambda name: None) as writer:
            for number, share in enumerate(EXPOSURES):
                camera.prepare(1000 + number)
                camera.set_exposure(trajectory.camera.exposure_us * share)
                image = camera.grab()
                taken_us.append(image.exposure_us)
                writer.put([(_frame(number, camera), [image])])
        response = Response.load(Path(folder) / RADIOMETRY).of_camera(camera.description(), where=rig)
        for frame, exposure_us in zip(recording.frames, taken_us, strict=True):
            white = camera.sensor.white(exposure_us, trajectory.camera.gain_db)
            plain = images.linear_from_stored(images.read_stored(recording.image_path(frame)))
            found.append(_error(develop(recording, frame, response).light, plain, CARDS["grey_card"] / white))
    return found


def nothing() -> None:
    """Called after each picture."""


def _frame(number: int, camera: Camera) -> Frame:
    name = f"{number:03d}"
    return Frame(
        index=number,
        name=name,
        split="train",
        image=f"images/{name}.png",
        base_from_flange=np.eye(4),
        joints=np.zeros(6),
        robot_time_s=0.0,
        host_time_ns=0,
        device_ticks=0,
        exposure_us=1.0,
        settle_s=0.0,
        sha256="",
    )


def _error(light: NDArray[np.float32], plain: NDArray[np.float32], true: float) -> CardError:
    colour, uneven = zip(*((_colour(picture), _uneven(picture)) for picture in (light, plain)), strict=True)
    return CardError(true, colour[0], colour[1], uneven[0], uneven[1], float(light.mean() / true))


def _colour(picture: NDArray[np.float32]) -> float:
    means = picture.mean(axis=(0, 1))
    return float(np.abs(means / means.mean() - 1).max())


def _uneven(picture: NDArray[np.float32]) -> float:
    parts = [part.mean() for rows in np.array_split(picture, BLOCKS) for part in np.array_split(rows, BLOCKS, axis=1)]
    return float(np.abs(np.array(parts) / np.mean(parts) - 1).max())


def lines(found: list[CardError]) -> list[str]:
    """A table for a person."""
    rows = ["light of the card   colour error, before   unevenness, before   level"]
    for one in found:
        colour = f"{100 * one.colour:10.2f} %{100 * one.colour_before:8.1f} %"
        uneven = f"{100 * one.uneven:9.2f} %{100 * one.uneven_before:8.1f} %"
        rows.append(f"{100 * one.light:8.1f} % of white {colour} {uneven} {one.level:10.3f}")
    return rows


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("trajectory", nargs="?", type=Path, default=Path("koala_demo"), metavar="TRAJECTORY")
    parser.add_argument("--rig", default="sim_flawed")
    parser.add_argument("--frames", type=int, default=32, help="pictures of the card, and of darkness")
    parser.add_argument("--set", action="append", metavar="KEY=VALUE", help="change a value of the trajectory")
    asked = parser.parse_args()
    found = errors(load_trajectory(asked.trajectory, overrides=asked.set), asked.rig, asked.frames)
    print("\n".join(lines(found)))


if __name__ == "__main__":
    main()
