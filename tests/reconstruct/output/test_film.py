from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.output import camera_path, film
from koala3d.reconstruct.output.trained_model import TrainedModel

av = pytest.importorskip("av", reason="the package 'av' is absent: no films can be read back")


def decoded(path: Path) -> np.ndarray:
    with av.open(str(path)) as file:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)])


def test_pictures_come_back_from_the_film(tmp_path: Path) -> None:
    """Smooth pictures of an odd size: compression and colour subsampling cost a few of 255 steps."""
    x, y = np.meshgrid(np.linspace(0, 1, 49), np.linspace(0, 1, 41))
    pictures = [(255 * np.stack([x, y, np.full_like(x, k / 5)], -1)).astype(np.uint8) for k in range(5)]
    assert film.write(pictures, tmp_path / "a.mp4", 25) == (48, 40)
    back = decoded(tmp_path / "a.mp4")
    assert back.shape == (5, 40, 48, 3)
    assert np.abs(back.astype(float) - np.stack(pictures)[:, :40, :48]).mean() < 4


def test_a_model_is_filmed_along_its_orbit(ball: TrainedModel, tmp_path: Path) -> None:
    frames = camera_path.orbit(ball.scene, 3)
    result = film.film(ball, frames, tmp_path / "ball.mp4", shown=("rgb", "normals", "depth_view"), fps=12)
    assert result["frames"] == 3 and result["size"] == [3 * 48, 40]
    back = decoded(tmp_path / "ball.mp4")
    assert back.shape == (3, 40, 144, 3)
    assert back[:, 0, 0].min() > 240, "white beside the ball"
    np.testing.assert_allclose(
        back[:, 20, 24] / 255, np.broadcast_to([0.58, 0.58, 0.62], (3, 3)), atol=0.05
    )  # srgb of 0.3, 0.3, 0.35


def test_misuse(ball: TrainedModel, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="did you mean 'normals'"):
        film.film(ball, [np.eye(4)], tmp_path / "a.mp4", shown=("normal",))
    with pytest.raises(UsageError, match=r"end --out in \.mp4"):
        film.film(ball, [np.eye(4)], tmp_path / "a.avi")
    with pytest.raises(UsageError, match="at least one frame"):
        film.film(ball, [], tmp_path / "a.mp4")
    assert not list(tmp_path.glob("*.mp4"))
