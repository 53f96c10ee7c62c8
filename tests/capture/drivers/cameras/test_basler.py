import time
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.drivers.cameras import genicam
from koala3d.capture.drivers.cameras.basler import Basler, EmulatedNodes, PylonNodes
from koala3d.capture.drivers.cameras.genicam import TRIES, exposed_at
from koala3d.capture.drivers.cameras.nodes import Limits
from koala3d.capture.drivers.errors import CaptureError, RigConnectionError
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings
from koala3d.capture.sim.camera_nodes import TICK_NS, SimulatedNodes
from koala3d.datasets.imaging import images
from koala3d.datasets.imaging.region import Region

SMALL = CameraSettings(width=64, height=48, binning=4, exposure_us=2000, gain_db=3)


@pytest.fixture
def picture(tmp_path: Path) -> tuple[str, np.ndarray]:
    pixels = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    images.write(tmp_path / "fed.png", pixels)
    return str(tmp_path / "fed.png"), pixels


def test_a_picture_file_is_delivered_unchanged(picture):
    path, pixels = picture
    with Basler(SMALL, emulated=True) as camera:
        camera.feed(path)
        first, second = camera.grab(), camera.grab()
    assert np.array_equal(first.pixels, pixels) and np.array_equal(second.pixels, pixels)
    assert first.exposure_us == 1995 and first.gain_db == pytest.approx(3, abs=0.01)
    assert second.host_time_ns > first.host_time_ns


def test_a_picture_stays_as_it_is_while_more_are_taken(picture, tmp_path):
    """Pylon reuses its buffers."""
    path, pixels = picture
    with Basler(SMALL, emulated=True) as camera:
        camera.feed(path)
        kept = camera.grab()
        images.write(tmp_path / "other.png", 255 - pixels)
        camera.feed(str(tmp_path / "other.png"))
        others = [camera.grab() for _ in range(12)]
    assert np.array_equal(others[-1].pixels, 255 - pixels)  # the premise
    assert np.array_equal(kept.pixels, pixels)


@pytest.mark.parametrize(("name", "kind"), [("bayer8", np.uint8), ("bayer12", np.uint16)])
def test_raw_formats_become_colours(tmp_path, name, kind):
    """The emulation makes photosites of the picture's values as they are, so these are the linear ones."""
    linear = np.zeros((48, 64, 3), np.uint8)
    linear[:, :32], linear[:, 32:] = (200, 100, 40), (10, 240, 90)
    images.write(tmp_path / "fed.png", linear)
    with Basler(SMALL.model_copy(update={"pixel_format": name}), emulated=True) as camera:
        camera.feed(str(tmp_path / "fed.png"))
        pixels = camera.grab().pixels
        described = camera.description()
    assert described["pixel_format"].startswith("Bayer") and pixels.dtype == kind
    wanted = images.srgb_from_linear(linear / 255)
    inside = np.r_[4:28, 36:60]
    np.testing.assert_allclose(pixels[4:-4, inside] / np.iinfo(kind).max, wanted[4:-4, inside], atol=0.006)


def test_region_is_that_part_of_the_sensor():
    with Basler(SMALL.model_copy(update={"offset_x": 16, "offset_y": 8}), emulated=True) as camera:
        assert camera.region == Region(64, 48, 16, 8, 4)
        assert camera.grab().pixels.shape == (48, 64, 3)


@pytest.mark.parametrize(("asked", "taken"), [(10_000, 10_010), (1250, 1260), (156.25, 140), (500, 490), (35, 35)])
def test_exposure_times_are_those_of_the_sensors_rows(asked, taken):
    """The sensor of the acA1920-25uc exposes in steps of 35 us."""
    with Basler(SMALL.model_copy(update={"exposure_us": asked}), emulated=True) as camera:
        assert camera.nodes.limits("ExposureTime").step == 35
        assert camera.grab().exposure_us == camera.description()["exposure_us"] == taken


def test_all_times_of_a_bracket_are_tried_when_the_camera_opens():
    bracketed = SMALL.model_copy(update={"exposure_us": 10_000, "brackets": 3})
    with Basler(bracketed, emulated=True) as camera:
        assert camera.grab().exposure_us == 10_010, "it begins with the longest"
    with pytest.raises(CaptureError, match=r"rejected ExposureTime .requested 19\.5"):
        Basler(bracketed.model_copy(update={"brackets": 4}), emulated=True).__enter__()


def test_a_camera_that_keeps_its_steps_to_itself_is_believed(monkeypatch):
    monkeypatch.setattr(EmulatedNodes, "limits", lambda self, name: Limits(*PylonNodes.limits(self, name)[:2]))
    with Basler(SMALL.model_copy(update={"exposure_us": 156.25, "offset_x": 0, "offset_y": 0}), emulated=True) as camera:
        assert camera.grab().exposure_us == 140


def test_binned_pixels_are_averaged_by_a_camera_that_can():
    with Basler(SMALL, emulated=True) as camera:
        described = camera.description()
        modes = [camera.nodes.read(f"Binning{axis}Mode") for axis in ("Horizontal", "Vertical")]
    assert modes == ["Average", "Average"], "pylon's own default is the sum"
    assert described["binning_modes"] == {"horizontal": "Average", "vertical": "Average"} and described["binning_gain"] == 1


@pytest.mark.parametrize(("family", "tick_ns"), [("ace USB", 1), ("ace GigE", TICK_NS)])
def test_a_picture_is_as_old_as_the_clock_of_the_camera_says(family, tick_ns):
    """The exposure began 30 ms after its trigger. Emulated pictures have no time stamp, and the emulation has no clock."""
    with Basler(CameraSettings(), emulated=True).inspected() as found:
        nodes = SimulatedNodes(found.nodes, family)
        now = time.monotonic_ns()
        triggered, begun = now - 60_000_000, now - 30_000_000
        assert exposed_at(nodes, begun // tick_ns, triggered) == pytest.approx(begun, abs=5e6)
        assert exposed_at(nodes, begun // tick_ns - 10**9, triggered) == triggered, "another clock"
        assert exposed_at(nodes, 0, triggered) == triggered
        assert exposed_at(found.nodes, begun, triggered) == triggered


@pytest.mark.parametrize(("binning", "gain", "exposure_us"), [(1, 1, 1995), (4, 4, 490)])
def test_a_camera_that_adds_columns_up_exposes_for_less(binning, gain, exposure_us):
    with Basler(SMALL.model_copy(update={"binning": binning}), emulated=True, sums=True) as camera:
        described, image = camera.description(), camera.grab()
    assert described["binning_modes"] == {"horizontal": "Sum", "vertical": "Average"} and described["binning_gain"] == gain
    assert image.exposure_us == described["exposure_us"] == exposure_us


def test_a_camera_that_does_not_say_what_binning_does_is_known_by_its_model(monkeypatch):
    has, read = EmulatedNodes.has, EmulatedNodes.read
    monkeypatch.setattr(EmulatedNodes, "has", lambda self, name: has(self, name) and not fnmatch(name, "Binning*Mode"))
    with Basler(SMALL, emulated=True) as camera:
        assert camera.description()["binning_modes"] == {"horizontal": "", "vertical": ""} and camera.binning_gain == 1
    model = "acA1920-25uc"
    monkeypatch.setattr(EmulatedNodes, "read", lambda self, name: model if name == "DeviceModelName" else read(self, name))
    with Basler(SMALL, emulated=True) as camera:
        assert camera.binning_gain == 4 and camera.grab().exposure_us == 490


def test_automatics_are_off_whatever_they_were_before():
    from pypylon import pylon

    other = pylon.InstantCamera(pylon.TlFactory.GetInstance().CreateFirstDevice())
    other.Open()
    other.ExposureAuto.Value, other.GainAuto.Value = "Continuous", "Continuous"
    other.Close()
    with Basler(SMALL, emulated=True) as camera:
        state = camera.description()["state"]
        assert (state["ExposureAuto"], state["GainAuto"]) == ("Off", "Off") and len(state) > 20


def test_damaged_images_are_retried(picture):
    path, pixels = picture
    with Basler(SMALL, emulated=True) as camera:
        camera.feed(path)
        camera.break_next(TRIES - 1)
        assert np.array_equal(camera.grab().pixels, pixels)
        camera.break_next(TRIES)
        with pytest.raises(CaptureError, match=r"damaged images in a row .*incomplete"):
            camera.grab()
        assert np.array_equal(camera.grab().pixels, pixels)  # and it works afterwards


@pytest.fixture
def numbered(tmp_path):
    """Pictures that the emulation shows one after another, and from the first one again when a stream starts: 10, 20, ..."""
    for number in range(1, 9):
        images.write(tmp_path / f"{number}.png", np.full((48, 64, 3), 10 * number, np.uint8))
    return str(tmp_path)


def test_a_picture_that_comes_late_is_not_taken_for_the_next_one(numbered, monkeypatch):
    with Basler(SMALL, emulated=True) as camera:
        camera.feed(numbered)
        assert [camera.grab().pixels[0, 0, 0] for _ in range(3)] == [10, 20, 30]
        with monkeypatch.context() as patched, pytest.raises(RigConnectionError, match=r"gave no image .nothing within"):
            patched.setattr(genicam, "TRANSFER_S", -1e-3)  # it takes about 10 ms
            camera.grab()
        time.sleep(0.1)
        assert [camera.grab().pixels[0, 0, 0] for _ in range(2)] == [10, 20], "not 40, which was triggered before"


def test_a_picture_that_nobody_asked_for_is_thrown_away(numbered):
    with Basler(SMALL, emulated=True) as camera:
        camera.feed(numbered)
        first = camera.grab()
        camera._camera.ExecuteSoftwareTrigger()
        time.sleep(0.1)
        second = camera.grab()
    assert (first.pixels[0, 0, 0], second.pixels[0, 0, 0]) == (10, 30)


def test_a_gap_in_the_numbers_of_the_pictures_is_noticed(numbered):
    """A picture was lost, so that nobody knows to which trigger this one belongs: it is taken again."""
    with Basler(SMALL, emulated=True) as camera:
        camera.feed(numbered)
        camera.grab()
        camera._number += 1
        assert camera.grab().pixels[0, 0, 0] == 30


def test_what_a_camera_says_of_a_picture_counts(numbered, monkeypatch):
    """The emulation sends no chunks; `_chunks_of` stands for a camera that exposes once with the time before."""
    said = [{"ExposureTime": 10_010.0}, {"ExposureTime": 1960.0, "Gain": 3.1, "Timestamp": 77.0}]
    monkeypatch.setattr(Basler, "_chunks_of", lambda self, result: said.pop(0))
    with Basler(SMALL, emulated=True) as camera:
        camera.feed(numbered)
        image = camera.grab()
    assert (image.exposure_us, image.gain_db, image.device_ticks) == (1960.0, 3.1, 77)
    assert image.pixels[0, 0, 0] == 20 and not said


def test_commands_that_can_only_be_written_are_there():
    with Basler(SMALL, emulated=True) as camera:
        assert camera.nodes.has("TriggerSoftware") and not camera.nodes.has("TimestampLatch")


def test_description_holds_the_state_as_read_back():
    with Basler(SMALL, emulated=True) as camera:
        described = camera.description()
    assert described["region"] == Region(64, 48, (480 - 64) // 2, (270 - 48) // 2, 4).to_json()
    assert described["sensor"] == {"width": 1920, "height": 1080}
    assert described["serial"] == "0815-0000" and described["exposure_us"] == 1995
    state = described["state"]
    assert described["pixel_format"] == "RGB8Packed" and state["ExposureAuto"] == "Off"
    assert [value for key, value in state.items() if key.startswith("TriggerMode") and "FrameStart" in key] == ["On"]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"binning": 5}, "BinningHorizontal.*requested 5.*1 to 4"),
        ({"exposure_us": 3e7}, "ExposureTime.*requested 30000000"),
        ({"gain_db": 60}, "Gain.*requested 60"),
        ({"width": 5000}, "Width.*requested 5000"),
        ({"offset_x": 4090, "width": 64}, "OffsetX.*requested 4090"),
    ],
)
def test_a_rejected_setting_is_named_and_the_camera_closed(changed, words):
    with pytest.raises(CaptureError, match=words):
        Basler(SMALL.model_copy(update=changed), emulated=True).__enter__()
    with Basler(SMALL, emulated=True):  # so it is free again
        pass


def test_a_missing_camera_is_an_error():
    with pytest.raises(RigConnectionError, match=r"camera 123: no Basler camera was found .*check cable"):
        Basler(SMALL, Device(serial="123"), emulated=True).__enter__()


def test_a_camera_in_use_is_an_error():
    with Basler(SMALL, emulated=True), pytest.raises(CaptureError):
        Basler(SMALL.model_copy(update={"gain_db": 99.0}), emulated=True).__enter__()


def test_closing_twice_is_harmless():
    camera = Basler(SMALL, emulated=True)
    camera.__enter__()
    camera.__exit__(None, None, None)
    camera.__exit__(None, None, None)
    with Basler(SMALL, emulated=True) as again:
        assert again.grab().pixels.any(), "the device is free for the next"
