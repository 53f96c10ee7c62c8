"""The page of a run, with a ball for a model whose picture is known."""

import os
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest
import trimesh

from koala3d.datasets.imaging import images
from koala3d.datasets.page import open_page
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.page.compose import CHANNELS, Viewpoint
from koala3d.reconstruct.page.run_page import NOTHING, RunPage, rounded_up
from koala3d.reconstruct.page.status import QUIET_S, is_training
from koala3d.reconstruct.rendering import pictures
from koala3d.reconstruct.run import CHECKPOINTS, LOG, Run
from tests.browser import Browse

pytestmark = pytest.mark.timeout(600)


@pytest.fixture
def shown(ball: TrainedModel) -> Any:
    """(page, view) of the ball."""
    with open_page("ball", 0) as page:
        view = RunPage(page, ball.run, None)
        view.trained = ball
        yield page, view


def viewpoint_at(trained: TrainedModel, index: int = 1) -> Viewpoint:
    view = trained.scene.views[index]
    fov = 2 * np.arctan(0.5 * view.camera.height / view.camera.fy)
    return Viewpoint(view.world_from_camera, float(fov), view.camera.width / view.camera.height)


def test_what_is_seen_is_what_the_renderer_makes_of_the_same_view(
    shown: Any, ball: TrainedModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sliced into rays of a fixed number, put together again: what `TrainedModel.picture` gives with one ray for each pixel."""
    monkeypatch.setattr(pictures, "PLACES", (pictures.MIDDLE,))
    _, view = shown
    camera = ball.scene.views[1].camera
    found = view.render(viewpoint_at(ball), camera.width * camera.height, normals=True)
    whole = ball.picture(ball.scene.views[1])
    assert found is not None and found["rgb"].shape == whole.rgb.shape
    for name in ("rgb", "opacity", "depth", "roughness"):
        assert np.allclose(found[name], getattr(whole, name), atol=2e-3), name  # chunks of another size round differently
    assert found["opacity"].max() > 0.99 and found["opacity"].min() < 0.01


def test_what_is_cut_away_opens_the_ball(shown: Any, ball: TrainedModel) -> None:
    """A plane through the ball's middle shows the far wall from inside (only the wall is in the grid) and nothing behind it."""
    _, view = shown
    viewpoint, centre = viewpoint_at(ball), np.array([0.4, 0.0, 0.15])
    reach = float((centre - viewpoint.world_from_camera[:3, 3]) @ viewpoint.world_from_camera[:3, 2])
    whole = view.render(viewpoint, 2048, normals=False)
    view.cut.value = reach
    opened = view.render(viewpoint, 2048, normals=False)
    view.cut.value = reach + 0.1
    behind = view.render(viewpoint, 2048, normals=False)
    row, column = (side // 2 for side in whole["depth"].shape[:2])
    assert whole["depth"][row, column, 0] == pytest.approx(reach - 0.08, abs=4e-3)  # the ball's radius; steps of the sampler
    wall = 3 / 32 * 0.1  # of the grid's cells that the fixture marks, at the scale of the scene
    assert (
        opened["depth"][row, column, 0] == pytest.approx(reach + 0.08 - wall, abs=4e-3)
        and opened["opacity"][row, column, 0] > 0.9
    )
    assert behind["opacity"].max() < 0.01


def test_what_is_beyond_the_far_plane_is_cut_away(shown: Any, ball: TrainedModel) -> None:
    """Only the front of the ball up to the middle plane remains; at its maximum the slider changes nothing."""
    _, view = shown
    viewpoint, centre = viewpoint_at(ball), np.array([0.4, 0.0, 0.15])
    reach = float((centre - viewpoint.world_from_camera[:3, 3]) @ viewpoint.world_from_camera[:3, 2])
    whole = view.render(viewpoint, 2048, normals=False)
    view.beyond.value = reach - 0.06
    front = view.render(viewpoint, 2048, normals=False)
    view.beyond.value = reach - 0.1
    nothing = view.render(viewpoint, 2048, normals=False)
    row, column = (side // 2 for side in whole["depth"].shape[:2])
    assert front["depth"][row, column, 0] == pytest.approx(whole["depth"][row, column, 0], abs=2e-3)
    assert (front["opacity"] > 0.5).sum() < 0.7 * (whole["opacity"] > 0.5).sum() and front["depth"].max() < reach - 0.05
    assert nothing["opacity"].max() < 0.01
    view.beyond.value, view.cut.value = reach + 0.03, reach  # a slice through the ball's inside, which is hollow
    assert view.render(viewpoint, 2048, normals=False)["opacity"][row, column, 0] < 0.01


def test_a_picture_that_nobody_wants_any_more_is_given_up(shown: Any, ball: TrainedModel) -> None:
    _, view = shown
    looks = iter([False, True])
    assert view.render(viewpoint_at(ball), 8192, normals=False, cancelled=lambda: next(looks)) is None
    assert list(looks) == []


def test_there_is_nothing_to_see_before_the_first_checkpoint(make_run: Callable[..., Any]) -> None:
    run = make_run(checkpointed=False)
    with open_page("new", 0) as page:
        view = RunPage(page, run, None)
        assert not view._take() and view.trained is None
        assert view.render(Viewpoint(np.eye(4), 0.7, 1.5), 2048, normals=False) is None


def test_a_newer_checkpoint_takes_the_place_of_the_one_before(make_run: Callable[..., Any]) -> None:
    from koala3d.reconstruct.training.step import Step

    run = make_run()
    with open_page("run", 0) as page:
        view = RunPage(page, run, None)
        assert view._take() and view.trained.step == 0
        state = Step.of(run.config, run.facts).initial(jax.random.key(1))
        later = replace(state, step=jax.numpy.asarray(41, jax.numpy.int32))
        checkpoint.save(run.path / CHECKPOINTS, later, {"seconds": 3.0})
        assert view._take() and view.trained.step == 41
        view._update_status()
        assert "step 41" in view._state.content


def test_a_training_that_is_under_way_is_given_room(make_run: Callable[..., Any]) -> None:
    run = make_run()
    with open_page("run", 0) as page:
        view = RunPage(page, run, None)
        assert not is_training(run) and view._levels() == view.sharpest.value  # the log says that it has ended
        run.append_log({"step": 3, "seconds": 3.0, "progress": 0.6, "psnr_train": 13.0, "skipped": 0})
        assert is_training(run) and view._levels() == view.sharpest_training.value < view.sharpest.value
        long_ago = time.time() - 2 * QUIET_S
        for path in (run.path / LOG, *checkpoint.steps(run.path / CHECKPOINTS)):
            os.utime(path, (long_ago, long_ago))
        assert not is_training(run)


@pytest.mark.parametrize(
    ("length", "end", "step"), [(0.8063, 0.81, 0.001), (2.0, 2.0, 0.01), (31.4, 32.0, 0.1), (0.0123, 0.013, 1e-4)]
)
def test_sliders_end_at_figures_that_can_be_read(length: float, end: float, step: float) -> None:
    assert rounded_up(length) == pytest.approx((end, step))


def test_a_mesh_can_be_switched_off_once_it_is_there(make_run: Callable[..., Run]) -> None:
    with open_page("mesh", 0) as page:
        view = RunPage(page, make_run(), None)
        assert not view.mesh.visible
        view._add_mesh(trimesh.creation.box())
        assert view.mesh.visible and view.mesh.value
        view._show_mesh(False)
        assert not page.scene.get_handle_by_name("/mesh").visible


def middle(picture: np.ndarray) -> np.ndarray:
    height, width = picture.shape[:2]
    return np.median(picture[height // 2 - 12 : height // 2 + 12, width // 2 - 12 : width // 2 + 12], axis=(0, 1))


def test_a_browser_sees_the_ball_and_what_it_chooses_of_it(ball: TrainedModel, browse: Browse) -> None:
    """The ball's colour in the middle, white beside it; another channel is another picture. The log is a curve; a path begins."""
    colour = 255 * images.srgb_from_linear(np.array([0.3, 0.3, 0.35]))
    with open_page("ball", 0) as page:
        view = RunPage(page, ball.run, None)
        view.trained, view.sharpest.value, view.cameras.value = ball, 1, False
        view._update_status()
        page.in_background(view.loop.run)
        with browse(page) as window:
            first = window.until(lambda picture: np.abs(middle(picture) - colour).max() < 12, "the ball")
            assert (first[-30:, 10:40] > 230).mean() > 0.9  # nothing stands in the corner
            window.choose("channel", "normals")
            window.until(lambda picture: np.abs(middle(picture) - colour).max() > 40, "another channel")
            window.choose("channel", NOTHING)
            window.until(lambda picture: (middle(picture) > 240).all(), "the page without a picture")
            window.page.locator(".uplot canvas").wait_for()
            window.page.get_by_text("Path", exact=True).click()
            window.page.get_by_text("add this view").click()
            window.page.get_by_text("1 stop", exact=True).wait_for()


def test_a_picture_that_is_being_sent_does_not_outlive_its_channel(shown: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A picture is being sent when its channel is left: the page is emptied after it, not before."""
    page, view = shown
    sending, go_on, sent = threading.Event(), threading.Event(), []

    def send(picture: np.ndarray | None, **_: Any) -> None:
        if picture is not None:
            sending.set()
            assert go_on.wait(60)
        sent.append(picture)

    browser = SimpleNamespace(scene=SimpleNamespace(set_background_image=send), flush=lambda: None)
    monkeypatch.setattr(page.server, "get_clients", lambda: {0: browser})
    painting = threading.Thread(target=view._paint, args=(browser, viewpoint_at(view.trained), 2048, lambda: False))
    painting.start()
    assert sending.wait(60)
    leaving = threading.Thread(target=setattr, args=(view.channel, "value", NOTHING))
    leaving.start()
    leaving.join(0.2)  # time for a page that does not wait for the picture
    go_on.set()
    for thread in (painting, leaving):
        thread.join()
    assert len(sent) == 2 and sent[1] is None


def test_every_channel_can_be_chosen(shown: Any, ball: TrainedModel) -> None:
    from koala3d.reconstruct.page.compose import picture_of

    _, view = shown
    values = view.render(viewpoint_at(ball), 2048, normals=True)
    pictures = {channel: picture_of(channel, values) for channel in CHANNELS}
    distinct = {name: p.tobytes() for name, p in pictures.items() if name != "normals (predicted)"}  # the ball predicts its own
    assert len(set(distinct.values())) == len(distinct)
