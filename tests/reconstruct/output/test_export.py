from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images
from koala3d.reconstruct.output import export
from koala3d.reconstruct.output.trained_model import TrainedModel


def test_every_channel_of_every_view_is_written(ball: TrainedModel, tmp_path: Path) -> None:
    assert export.render(ball, tmp_path / "out")["views"] == 2
    folders = {path.name for path in (tmp_path / "out").iterdir()}
    assert folders == {"rgb", "diffuse", "specular", "normals", "normals_exr", "normals_pred", "depth", "depth_view",
                       "opacity", "roughness"}  # fmt: skip
    for folder in folders:
        suffix = ".exr" if folder in ("depth", "normals_exr") else ".png"
        assert sorted(p.name for p in (tmp_path / "out" / folder).iterdir()) == [f"000{suffix}", f"003{suffix}"]
    view = ball.scene.split("test")[0]
    picture = ball.picture(view)
    assert np.array_equal(images.read(tmp_path / "out/depth/000.exr"), picture.depth), "depth is kept as it is, in metres"
    middle = (20, 24)
    assert picture.depth[middle] == pytest.approx(np.linalg.norm(view.world_from_camera[:3, 3] - [0.4, 0, 0.15]) - 0.08, abs=2e-3)
    assert np.array_equal(images.read(tmp_path / "out/normals_exr/000.exr"), picture.normals)
    normal = 2 * images.read(tmp_path / "out/normals/000.png")[middle] - 1
    towards = -view.world_from_camera[:3, 2]
    assert np.degrees(np.arccos(np.clip(normal @ towards, -1, 1))) < 2  # 8 bits are 0.2 degrees, half a pixel is 1.3
    assert np.allclose(images.read(tmp_path / "out/normals/000.png")[0, 0], 0.5, atol=3e-3), "grey where nothing is"
    diffuse = images.linear_from_srgb(images.read(tmp_path / "out/diffuse/000.png")[middle])
    assert diffuse == pytest.approx([0.1, 0.2, 0.3], abs=3e-3)
    assert images.read(tmp_path / "out/roughness/000.png")[middle] == pytest.approx(0.25, abs=3e-3)


def test_it_never_overwrites_and_leaves_nothing_on_failure(
    ball: TrainedModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("mine")
    with pytest.raises(UsageError, match="already exists"):
        export.render(ball, tmp_path / "out")

    def full(path: Path, values: np.ndarray) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(export.images, "write", full)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(OSError, match="No space"):
        export.render(ball, tmp_path / "new")
    assert sorted(tmp_path.iterdir()) == before


def test_brightness_of_depth() -> None:
    depth = np.array([[[0.0], [1.0], [1.5], [2.0], [9.0]]])
    assert export.brightness_of_depth(depth, (1.0, 2.0)).ravel() == pytest.approx([0, 1, 0.55, 0.1, 0.1])
    assert not export.brightness_of_depth(0 * depth).any()


def test_frames_of_a_path_are_what_the_renderer_sees_from_there(ball: TrainedModel, tmp_path: Path) -> None:
    views = ball.scene.views
    frames = [view.world_from_camera for view in (views[1], views[0])]
    assert export.render_along(ball, frames, tmp_path / "out") == {"out": str(tmp_path / "out"), "views": 2}
    assert sorted(p.name for p in (tmp_path / "out" / "rgb").iterdir()) == ["0000.png", "0001.png"]
    seen = ball.renderer.picture(ball.model, views[1], ball.camera(views[0]).undistorted())
    assert np.array_equal(images.read(tmp_path / "out/depth/0000.exr"), seen.depth)
    with pytest.raises(UsageError, match="already exists"):
        export.render_along(ball, frames, tmp_path / "out")
