"""What is written is read back by a separate reader: records are TensorFlow's, events are protocol buffers."""

import struct
import sys
from pathlib import Path

import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.models import merged_config
from koala3d.reconstruct.run import Run
from koala3d.reconstruct.training.event_log import event_log, scalars_of
from koala3d.reconstruct.training.loop import train

LINE = {
    "step": 16,
    "seconds": 0.25,
    "progress": 0.5,
    "psnr_train": 21.5,
    "skipped": 0,
    "terms": {"photometric": 0.125, "mse": 0.0625},
}


def checksum(data: bytes) -> int:
    """Masked CRC-32C, bit by bit."""
    value = 0xFFFFFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0x82F63B78 if value & 1 else 0)
    value ^= 0xFFFFFFFF
    return ((value >> 15 | value << 17) + 0xA282EAD8) & 0xFFFFFFFF


def records(path: Path) -> list[bytes]:
    """Length, its checksum, data, its checksum; again and again."""
    data, found = path.read_bytes(), []
    while data:
        length, first = struct.unpack("<QI", data[:12])
        body, rest = data[12 : 12 + length], data[12 + length :]
        assert first == checksum(data[:8]) and struct.unpack("<I", rest[:4]) == (checksum(body),)
        found.append(body)
        data = rest[4:]
    return found


def scalars(run: Path) -> list[dict[int, dict[str, float]]]:
    """Per event file, oldest first: the values at each step by name."""
    event_pb2 = pytest.importorskip("tensorboardX.proto.event_pb2", reason="tensorboardX is absent: pip install '.[test]'")
    files: list[dict[int, dict[str, float]]] = []
    for path in sorted(run.glob("events.out.tfevents.*"), key=lambda path: path.stat().st_mtime_ns):
        steps: dict[int, dict[str, float]] = {}
        for event in map(event_pb2.Event.FromString, records(path)):
            for value in event.summary.value:
                steps.setdefault(event.step, {})[value.tag] = value.simple_value
        files.append(steps)
    return files


def test_losses_are_a_group_of_their_own() -> None:
    assert scalars_of(LINE) == {
        "seconds": 0.25,
        "progress": 0.5,
        "psnr_train": 21.5,
        "skipped": 0,
        "loss/photometric": 0.125,
        "loss/mse": 0.0625,
    }
    assert scalars_of({"step": 1}) == {}


def test_each_line_is_on_the_disk_when_it_was_written(tmp_path: Path) -> None:
    with event_log(tmp_path, wanted=True) as log:
        log.write(LINE)
        assert scalars(tmp_path) == [{16: scalars_of(LINE)}], "all of these are exact in float32"
        log.write({**LINE, "step": 32, "seconds": 0.5})
    assert scalars(tmp_path)[0][32]["seconds"] == 0.5


def test_what_a_broken_off_training_said_of_later_steps_counts_no_more(tmp_path: Path) -> None:
    """TensorBoard drops what other files have at or after the step of a start event."""
    from tensorboardX.proto import event_pb2

    with event_log(tmp_path, wanted=True, step=16) as log:
        log.write(LINE)
    (path,) = tmp_path.iterdir()
    events = [event_pb2.Event.FromString(record) for record in records(path)]
    (begun,) = [event for event in events if event.HasField("session_log")]
    assert begun.step == 17 and begun.session_log.status == event_pb2.SessionLog.START


def test_nothing_is_written_where_nobody_wants_it(tmp_path: Path) -> None:
    with event_log(tmp_path, wanted=False) as log:
        assert log is None
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("two_steps_at_once")
def test_a_training_writes_every_figure_of_its_log(ball_scene: tuple[Scene, Path], small_config: Config, tmp_path: Path) -> None:
    scene, folder = ball_scene
    config = merged_config(small_config, {"train": {"steps": 6, "tensorboard": True}})
    train(scene.with_views(scene.split("train")), folder, config, tmp_path / "run")
    (written,) = scalars(tmp_path / "run")
    log = Run.open(tmp_path / "run").log()
    assert list(written) == [line["step"] for line in log] == [2, 4, 6]
    for line in log:
        assert {"psnr_train", "occupied", "skipped", "loss/mse", "loss/photometric"} <= set(scalars_of(line))
        assert written[line["step"]] == pytest.approx(scalars_of(line), rel=1e-7), "float32 in the file"


def test_without_its_writer_no_training_begins(
    ball_scene: tuple[Scene, Path], small_config: Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "tensorboardX", None)  # as if it were not installed
    scene, folder = ball_scene
    with pytest.raises(UsageError, match=r"tensorboardX is not installed.*pip install 'koala-capture\[tensorboard\]'"):
        train(scene, folder, merged_config(small_config, {"train": {"tensorboard": True}}), tmp_path / "run")
    assert not (tmp_path / "run").exists()
