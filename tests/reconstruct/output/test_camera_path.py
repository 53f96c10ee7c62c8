from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.output import camera_path

CENTRE = np.array([0.4, 0.0, 0.15])


def test_an_orbit_keeps_distance_and_height_and_looks_at_the_middle(ball_scene: tuple[Scene, Path]) -> None:
    frames = np.stack(camera_path.orbit(ball_scene[0], 12))
    offset = frames[:, :3, 3] - CENTRE
    # the scene's cameras circle at 0.3 m, their up directions lean by turns: the orbit's axis is within a few degrees of z
    np.testing.assert_allclose(np.linalg.norm(offset, axis=-1), np.linalg.norm(offset[0]), rtol=1e-9)
    towards = -offset / np.linalg.norm(offset, axis=-1, keepdims=True)
    np.testing.assert_allclose(frames[:, :3, 2], towards, atol=1e-9)
    steps = np.linalg.norm(np.diff(np.concatenate([offset, offset[:1]]), axis=0), axis=-1)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)
    assert 0.25 < np.linalg.norm(offset[0]) < 0.4


def write(path: Path, closed: bool, extra: str = "") -> Path:
    path.write_text(
        f"fps: 10\nseconds: 2\nclosed: {str(closed).lower()}\nposes:\n"
        "  - {position: [1, 0, 0.5], target: [0, 0, 0]}\n"
        "  - {position: [0, 1, 0.5], target: [0, 0, 0]}\n"
        f"  - {{position: [-1, 0, 0.5], target: [0, 0, 0]}}\n{extra}"
    )
    return path


@pytest.mark.parametrize("closed", [False, True])
def test_a_path_passes_its_poses_smoothly(tmp_path: Path, closed: bool) -> None:
    frames, fps = camera_path.from_file(write(tmp_path / "path.yaml", closed))
    assert fps == 10 and len(frames) == 20
    places = np.stack(frames)[:, :3, 3]
    np.testing.assert_allclose(places[0], [1, 0, 0.5], atol=1e-12)
    if not closed:
        np.testing.assert_allclose(places[-1], [-1, 0, 0.5], atol=1e-12)
    around = np.concatenate([places, places[:1]]) if closed else places
    steps = np.diff(around, axis=0)
    # a right-angled corner would change the step by 1.4 of its length, a jump by more
    assert np.abs(np.diff(steps, axis=0)).max() < 0.5 * np.abs(steps).max()
    for frame in frames:
        np.testing.assert_allclose(frame[:3, :3] @ frame[:3, :3].T, np.eye(3), atol=1e-9)


def test_mistakes_are_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="did you mean 'closed'"):
        camera_path.from_file(write(tmp_path / "a.yaml", False, "clsoed: true\n"))
    (tmp_path / "b.yaml").write_text(
        "poses:\n - {position: [0, 0, 1], target: [0, 0, 0]}\n - {position: [1, 0, 1], target: [0, 0, 0]}\n"
    )
    with pytest.raises(UsageError, match="looks along its up direction"):
        camera_path.from_file(tmp_path / "b.yaml")
    with pytest.raises(UsageError, match="no such file"):
        camera_path.from_file(tmp_path / "none.yaml")
