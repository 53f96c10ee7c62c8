from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.datasets.imaging import images
from koala3d.datasets.scene import View
from koala3d.reconstruct.output import evaluate
from koala3d.reconstruct.output.align import PIXELS, Aligner
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.rendering import pictures
from koala3d.reconstruct.scene import poses


@pytest.fixture
def photographed(painted: TrainedModel, tmp_path, monkeypatch: pytest.MonkeyPatch) -> TrainedModel:
    """The painted ball with test pictures taken through the model itself, by the rays that alignment compares."""
    monkeypatch.setattr(pictures, "PLACES", (pictures.MIDDLE,))
    views = []
    for view in painted.scene.views:
        image = tmp_path / f"{view.name}.png"
        if view.split == "test":
            images.write(image, np.asarray(painted.picture(view).rgb))
            view = replace(view, image=image)
        views.append(view)
    return replace(painted, scene=painted.scene.with_views(tuple(views)))


def away(view: View, seed: int) -> View:
    """The view from a pose that is off by two of the calibration's standard deviations along each axis: 1 mm, 0.1 degrees."""
    sign = np.where(np.random.default_rng(seed).random(6) < 0.5, -2, 2)
    twist = sign * np.array([5e-4] * 3 + [8.7e-4] * 3)
    return replace(view, world_from_camera=poses.corrected(view.world_from_camera, twist, 1.0))


def test_views_are_aligned_beside_the_figures_of_the_poses_as_given(
    photographed: TrainedModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Poses that are right stay, those that are off come back, and what is measured without alignment never changes."""
    monkeypatch.setattr(evaluate, "TRUE_SURFACE", "no mesh")  # which would take longer than all the rest
    scene = photographed.scene
    box, before = scene.box, photographed.model
    views = tuple(away(view, 3) if index == 0 else view for index, view in enumerate(scene.views))
    assert views[0].split == "test"
    trained = replace(photographed, scene=scene.with_views(views))
    plain = evaluate.evaluate(trained)
    assert "aligned" not in plain
    for old, new in zip(views, trained.scene.views, strict=True):
        np.testing.assert_array_equal(old.world_from_camera, new.world_from_camera)
    both = evaluate.evaluate(trained, align=True)
    strip = lambda figures: {name: value for name, value in figures.items() if name != "seconds"}  # noqa: E731
    assert strip(both["mean"]) == strip(plain["mean"])
    assert [strip(view) for view in both["per_view"]] == [strip(view) for view in plain["per_view"]]

    off, right = both["aligned"]["per_view"]
    assert off["psnr"] > plain["per_view"][0]["psnr"] + 6 and right["psnr"] > plain["per_view"][1]["psnr"] - 0.1
    assert off["pixels"] == min(PIXELS, 48 * 40 // 2), "at most every other pixel decides"
    assert set(both["aligned"]["definitions"]) >= {"aligned", "moved_mm", "turned_deg", "moved_px"}
    assert "PSNR [dB], poses aligned" in evaluate.table(both) and "aligned" not in evaluate.table(plain)
    aligned = Aligner(trained)(views[0]).view
    apart = [poses.change(scene.views[0], view, box)["moved_px"] for view in (views[0], aligned)]
    assert apart[0] > 0.15 and apart[1] < 0.2 * apart[0], apart  # what the steps along each ray of 2 mm leave
    assert right["moved_px"] < 0.05
    assert trained.model is before, "the model stays as it was"


def test_a_picture_of_another_exposure_is_aligned_as_well(photographed: TrainedModel) -> None:
    view = photographed.scene.views[0]
    light = images.linear_from_srgb(images.read(view.image)[..., :3]) * 0.6
    alpha = photographed.picture(view).opacity
    dark = images.srgb_from_linear(light) * alpha + 1 - alpha  # over white as before: only the ball is darker, but at its rim
    image = view.image.with_name("dark.png")
    images.write(image, dark)
    wrong = replace(away(view, 3), image=image)
    learned = replace(photographed, model=replace(photographed.model, per_image=jnp.zeros((4, 1))))
    box = photographed.scene.box
    apart = [poses.change(view, one, box)["moved_px"] for one in (wrong, Aligner(learned)(wrong).view)]
    assert apart[0] > 0.15 and apart[1] < 0.3 * apart[0], apart  # 0.2 where the exposure is the model's own
