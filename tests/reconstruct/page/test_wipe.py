"""What is right of the wipe: nothing, a photograph, or the asset under its light."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import viser

from koala3d.datasets import pose
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.imaging import images
from koala3d.datasets.page import open_page
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.page.compose import Viewpoint
from koala3d.reconstruct.page.wipe import ASSET, NOTHING, PHOTOGRAPH, LitAsset, Wipe, lit_asset
from koala3d.reconstruct.path_tracing import trial

pytest.importorskip("mitsuba", reason="Mitsuba is absent: pip install 'koala-capture[sim]'")
FRONT = Viewpoint(pose.look_at(np.array([0.0, 0, 5]), np.zeros(3), up=np.array([0.0, 1, 0])), 0.8, 1.5)
RAYS = 600


@pytest.fixture
def gui() -> Iterator[viser.GuiApi]:
    with open_page("wipe", 0) as page:
        yield page.gui


@pytest.fixture
def lit(tmp_path: Path) -> LitAsset:
    """A rough metal ball under one lamp, which stands at the left."""
    light = np.full((16, 32, 4), 0.2, np.float32)
    light[6:10, 22:26, :3] = 20.0  # x is in the middle, z a quarter further right
    images.write(tmp_path / "light.exr", light)
    return LitAsset(replace(trial.ball(), roughness=np.full((4, 4, 1), 0.4, np.float32)), tmp_path / "light.exr")


def brightest_column(picture: np.ndarray) -> float:
    """Of the ball's middle rows, inside its outline: the mean column of what is brighter than half the most."""
    ball = picture[20:60, 42:78].sum((0, 2))
    return float(np.average(np.arange(42, 78), weights=np.maximum(ball - ball.mean(), 0)))


def test_the_asset_is_right_of_the_wipe_and_its_light_can_be_turned(gui: viser.GuiApi, lit: LitAsset) -> None:
    wipe, model = Wipe(gui, (), 1.0, lit), np.zeros((80, 120, 3), np.float32)
    assert wipe.against.value == ASSET and wipe.turn.visible
    half = wipe.over(model, FRONT, RAYS)
    assert half.shape == model.shape and not half[:, :59].any()
    assert np.allclose(half[:8, 62:], 1) and half[40, 64:76].mean() < 0.95  # white beside the ball
    wipe.share.value = 0.0
    ahead = brightest_column(wipe.over(model, FRONT, RAYS))
    wipe.turn.value = 60
    assert brightest_column(wipe.over(model, FRONT, RAYS)) > ahead + 3  # from z towards x, which is right


def test_without_an_asset_photographs_are_the_choice(gui: viser.GuiApi, ball: TrainedModel) -> None:
    view = ball.scene.split("train")[0]
    wipe = Wipe(gui, (view,), 1.0, None)
    assert wipe.against.options == (NOTHING, PHOTOGRAPH) and not wipe.turn.visible
    model, place = np.zeros((60, 80, 3), np.float32), Viewpoint(view.world_from_camera, 0.7, 4 / 3)
    assert wipe.over(model, place, RAYS) is model
    wipe.against.value = PHOTOGRAPH
    shown = wipe.over(model, place, RAYS)
    assert not shown[:, :39].any() and shown[:, 42:].mean() > 0.1


def test_files_that_are_no_asset_and_no_light_are_refused(tmp_path: Path, lit: LitAsset) -> None:
    (tmp_path / "ball.glb").write_bytes(b"no such thing")
    with pytest.raises(DatasetError, match="not an asset"):
        lit_asset(tmp_path / "ball.glb", lit.light)
    with pytest.raises(UsageError, match="no such image"):
        lit_asset(tmp_path / "ball.glb", tmp_path / "dark.exr")
