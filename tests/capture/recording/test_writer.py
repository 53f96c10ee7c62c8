import threading

import numpy as np
import pytest

from koala3d.capture.drivers.measurements import Image
from koala3d.capture.recording import writer as module
from koala3d.capture.recording.writer import Writer
from koala3d.datasets.core import files
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import Frame, Recording
from tests.moments import until


@pytest.fixture
def recording(tmp_path):
    return Recording.create(tmp_path / "recording", {"trajectory": {}})


def frame(index):
    return Frame(
        index=index,
        name=f"{index:03d}",
        split="train",
        image=f"images/{index:03d}.png",
        base_from_flange=np.eye(4),
        joints=np.zeros(6),
        robot_time_s=0.0,
        host_time_ns=0,
        device_ticks=0,
        exposure_us=1e4,
        settle_s=0.1,
        sha256="",
    )


def pictures(index):
    return [Image(np.full((8, 9, 3), index, np.uint8), 1e4, 0.0, index, index)]


def test_frames_are_written_in_order_with_their_hash(recording):
    seen = []
    with Writer([recording], seen.append) as writer:
        for index in range(10):
            writer.put([(frame(index), pictures(index))])
    read = Recording.open(recording.path)
    assert [one.name for one in read.frames] == seen == [f"{index:03d}" for index in range(10)]
    assert all(one.sha256 == files.sha256(read.image_path(one)) for one in read.frames)


def test_what_was_taken_is_kept_when_something_else_fails(recording):
    with pytest.raises(KeyboardInterrupt), Writer([recording], lambda name: None) as writer:
        writer.put([(frame(0), pictures(0))])
        writer.put([(frame(1), pictures(1))])
        raise KeyboardInterrupt
    assert len(Recording.open(recording.path).frames) == 2


def test_a_full_disk_is_an_error_of_the_next_frame_or_at_the_end(recording, monkeypatch):
    def full(path, array):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(module.images, "write", full)
    with pytest.raises(OSError, match="No space left"), Writer([recording], lambda name: None) as writer:
        writer.put([(frame(0), pictures(0))])
        until(lambda: writer._failure, "the error of the thread")
        writer.put([(frame(1), pictures(1))])
        pytest.fail("took a frame after the error")
    with pytest.raises(OSError, match="No space left"), Writer([recording], lambda name: None) as writer:
        writer.put([(frame(0), pictures(0))])
    assert not Recording.open(recording.path).frames


def test_a_slow_disk_makes_the_arm_wait_instead_of_filling_the_memory(recording, monkeypatch):
    gate, written = threading.Event(), []
    monkeypatch.setattr(
        module.images, "write", lambda path, array: (gate.wait(60), written.append(path), images_write(path, array))
    )
    with Writer([recording], lambda name: None) as writer:
        third = threading.Thread(target=lambda: [writer.put([(frame(index), pictures(index))]) for index in range(5)])
        third.start()
        try:
            until(writer._queue.full, "as many frames as may wait")
            assert third.is_alive() and not written
        finally:
            gate.set()
            third.join()
    assert len(Recording.open(recording.path).frames) == 5


images_write = images.write
