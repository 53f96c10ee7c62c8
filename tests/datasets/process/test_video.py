"""From a video to a scene."""

from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest

pytest.importorskip("pycolmap")

from koala3d.datasets import pose
from koala3d.datasets.formats import load_scene
from koala3d.datasets.process.process import Request, process
from koala3d.datasets.process.world import similarity
from koala3d.datasets.process.world.alignment import Wishes

SLOWLY = 40


@pytest.mark.slow
def test_frames_of_a_video_get_their_poses(photograph_of: Callable, ring_of: Callable, tmp_path: Path) -> None:
    """A camera on an arc of 60 degrees, which rests for ten frames in between."""
    poses = ring_of(SLOWLY, sweep_deg=60.0, wave=0.0)
    poses = [*poses[:20], *[poses[20]] * 10, *poses[20:]]
    video = tmp_path / "walk.mp4"
    with av.open(str(video), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = 400, 300, "yuv420p", 20_000_000
        for matrix in poses:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(photograph_of(matrix), "rgb24")))
        container.mux(stream.encode())
    found = process(video, tmp_path / "scene", Request(frames=12), Wishes())
    scene = load_scene(tmp_path / "scene")
    assert len(scene.views) == found.given == 12 and all(view.name.startswith("frame_0000") for view in scene.views)
    truth = np.stack([poses[int(view.name.removeprefix("frame_"))] for view in scene.views])
    world = similarity.between([view.world_from_camera[:3, 3] for view in scene.views], truth[:, :3, 3])
    distance, angle = pose.difference([world.view(view).world_from_camera for view in scene.views], truth)
    assert distance.max() < 0.02  # of 2 m
    assert np.rad2deg(angle).max() < 0.8  # a circle at one height leaves the principal point in the middle, 0.58 degrees off
    assert not (tmp_path / "scene.work").exists()
