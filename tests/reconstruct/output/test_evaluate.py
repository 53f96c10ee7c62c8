import json
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import View
from koala3d.reconstruct.field.appearance import Material, Shading
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.output import evaluate
from koala3d.reconstruct.output.trained_model import TrainedModel

STEP_MM = 2 * 0.1 / 192 * np.sqrt(3) * 1e3
"""A ray is cut into 192 steps through a box of 0.2 m; along its diagonal a step is this long."""


def test_a_model_that_is_the_truth_scores_as_one(ball: TrainedModel) -> None:
    """The error comes from steps of about 1 mm at the rim, where one ray stands for a whole pixel."""
    before = {"format": evaluate.FORMAT, "version": evaluate.VERSION, "steps": ball.step, "old": 1, "asset": {"views": 2}}
    (ball.run.path / "metrics.json").write_text(json.dumps(before))
    result = evaluate.evaluate(ball)
    assert result["asset"] == {"views": 2} and "old" not in result  # `reconstruct eval --asset` measured the same state
    found = result["mean"]
    assert result["views"] == 2 and result["size"] == [48, 40] and result["split"] == "test"
    assert found["psnr"] > 25 and found["ssim"] > 0.93
    assert found["psnr_inside"] > found["psnr"] and found["ssim_inside"] > found["ssim"], "the rim is where a ray is a pixel"
    assert found["normal_mae_alpha_acc_deg"] < 1.5 and found["normal_pred_mae_deg"] < 1.5
    assert found["depth_median_mm"] < STEP_MM and found["depth_rmse_mm"] < 5 * STEP_MM
    assert found["disparity_rmse"] < 5e-3
    assert found["diffuse_psnr"] > 25 and found["specular_psnr"] > 25
    assert result["mesh"]["chamfer_mm"] < STEP_MM and result["mesh"]["f_score"] > 0.99
    written = json.loads((ball.run.path / "metrics.json").read_text())
    assert written["mean"] == found and set(found) <= set(written["definitions"])
    assert written["mean"]["psnr"] == pytest.approx(np.mean([view["psnr"] for view in written["per_view"]]))
    shown = evaluate.table(result)
    assert "2 test views at 48x40" in shown and "mesh, Chamfer distance [mm]" in shown and "depth, median error [mm]" in shown
    assert result["mesh_stands_on"] is None and "any side but" not in shown


class Walled(Field):
    """Another field with a wall along the -y side of the object's box; its colours are the other's."""

    inner: Field

    @classmethod
    def around(cls, inner: Field) -> "Walled":
        return cls(inner.encoding, inner.spatial, inner.appearance, inner.density_bias, inner.deferred, inner)

    def density(self, cloud: Cloud) -> jax.Array:
        return jnp.maximum(self.inner.density(cloud), 2000 * jax.nn.sigmoid((-0.9 - cloud.points[1]) / 0.002))

    def __call__(self, cloud: Cloud) -> tuple[jax.Array, Material]:
        return self.density(cloud), self.inner(cloud)[1]

    def shade(
        self,
        material: Material,
        viewdirs: jax.Array,
        normals: jax.Array | None = None,
        light: Lit | None = None,
        places: jax.Array | None = None,
    ) -> Shading:
        return self.inner.shade(material, viewdirs, normals)


@pytest.mark.slow
def test_a_wall_beside_the_object_is_measured_unless_it_is_said_what_the_object_stands_on(ball: TrainedModel) -> None:
    truth = Path(ball.run.scene_path) / evaluate.TRUE_SURFACE
    grid = ball.model.sampler.grid
    sampler = replace(ball.model.sampler, grid=grid.with_occupied(jnp.ones_like(grid.occupied)))
    walled = replace(ball, model=replace(ball.model, field=Walled.around(ball.model.field), sampler=sampler))
    assert evaluate.compare_surface(walled, truth)["accuracy_mm"] > 10
    alone = evaluate.compare_surface(walled, truth, "-z")
    assert alone["accuracy_mm"] < STEP_MM and alone["completeness_mm"] < STEP_MM


def test_missing_split_is_misuse(ball: TrainedModel) -> None:
    with pytest.raises(UsageError, match="no val views"):
        evaluate.evaluate(ball, split="val")


def test_truth_keeps_its_meaning_at_another_size(ball: TrainedModel) -> None:
    view = ball.scene.split("test")[0]
    full = evaluate.read_truth(view, view.camera)
    half = evaluate.read_truth(view, view.camera.scaled(24, 20))
    length = np.linalg.norm(half["normals"], axis=-1)
    shown = half["alpha"][..., 0] == 1
    assert shown.any() and np.allclose(length[shown], 1, atol=1e-5)
    block = full["depth"].reshape(20, 2, 24, 2).mean((1, 3))
    assert np.allclose(half["depth"][shown, 0], block[shown], atol=1e-6)
    rim = (half["depth"][..., 0] > 0) & ~shown
    known = full["depth"][full["depth"] > 0]
    assert rim.any() and (half["depth"][rim] >= known.min() - 1e-6).all(), "no mean with pixels that have no depth"
    assert np.allclose(half["alpha"][..., 0], full["alpha"].reshape(20, 2, 24, 2).mean((1, 3)))


def test_picture_is_laid_over_white_and_gives_the_alpha(ball: TrainedModel) -> None:
    view = ball.scene.split("train")[0]
    truth = evaluate.read_truth(view, view.camera)
    assert not view.truth and set(truth) == {"rgb", "alpha"}
    assert (truth["rgb"][truth["alpha"][..., 0] == 0] == 1).all()


def test_the_picture_is_whole_though_a_mask_that_was_found_is_not(ball: TrainedModel, tmp_path: Path) -> None:
    view = ball.scene.split("test")[0]
    whole = evaluate.read_truth(view, view.camera)
    images.write(tmp_path / "bitten.png", whole["alpha"] * (np.arange(48) < 24)[:, None])
    found = evaluate.read_truth(replace(view, mask=tmp_path / "bitten.png"), view.camera)
    np.testing.assert_allclose(found["rgb"], whole["rgb"], atol=2 / 255)  # of two alphas of eight bits
    np.testing.assert_array_equal(found["alpha"], whole["alpha"])


def test_without_truth_only_the_picture_is_compared(ball: TrainedModel) -> None:
    view: View = ball.scene.split("train")[0]
    found = evaluate.compare(vars(ball.picture(view)), evaluate.read_truth(view, view.camera), metric=True)
    assert set(found) == {"psnr", "ssim", "psnr_inside", "ssim_inside"}


def test_errors_at_the_edge_of_a_mask_do_not_count_inside() -> None:
    """A disc that is drawn 3 px too small: the picture suffers, its inside does not."""
    rows, columns = np.mgrid[:64, :64] - 31.5
    disc = lambda radius: np.float32(rows**2 + columns**2 < radius**2)[..., None]  # noqa: E731
    truth = {"rgb": 1 - 0.5 * np.repeat(disc(20), 3, -1), "alpha": disc(20)}
    found = evaluate.compare({"rgb": 1 - 0.5 * np.repeat(disc(17), 3, -1)}, truth, metric=False)
    assert found["psnr"] < 20 and found["psnr_inside"] == 100
    assert found["ssim"] < 0.95 and found["ssim_inside"] > found["ssim"]
    known = evaluate.compare({"rgb": truth["rgb"]}, {"rgb": truth["rgb"]}, metric=False)
    assert "psnr_inside" not in known, "without a mask nothing is inside it"


def test_mean_leaves_out_what_a_view_lacks() -> None:
    found = evaluate.mean([{"psnr": 20.0, "ssim": None}, {"psnr": 30.0, "ssim": 0.5, "depth_rmse_mm": 2.0}])
    assert found == {"psnr": 25.0, "ssim": 0.5, "depth_rmse_mm": 2.0}


def test_the_separation_of_light_is_measured_on_the_object_alone() -> None:
    """A wall behind the object whose parts are all wrong does not count; on the object an error of 0.1 in sRGB is 20 dB."""
    alpha = np.zeros((4, 4, 1), np.float32)
    alpha[1:3, 1:3] = 1
    true, off = (images.linear_from_srgb(np.full((4, 4, 3), value, np.float32)) for value in (0.5, 0.6))
    truth = {"rgb": true, "alpha": alpha, "diffuse": true, "specular": true}
    shown = {"rgb": true, "diffuse": np.where(alpha > 0, off, 0), "specular": np.where(alpha > 0, true, 9)}
    found = evaluate.compare(shown, truth, metric=True)
    assert found["diffuse_psnr"] == pytest.approx(20, abs=1e-3) and found["specular_psnr"] == pytest.approx(100)


def test_normals_that_nobody_predicts_are_not_measured() -> None:
    up = np.broadcast_to(np.array([0, 0, 1], np.float32), (4, 4, 3))
    found = evaluate.compare({"rgb": up, "normals": up, "normals_pred": 0 * up}, {"rgb": up, "normals": up}, metric=False)
    assert found["normal_mae_deg"] == 0 and "normal_pred_mae_deg" not in found


def test_exposure_of_unseen_views_is_fitted_where_training_views_have_gains(ball: TrainedModel, without_mesh: None) -> None:
    """Pictures of 1.8 times the light and another white balance: as good as the true ones, and said so."""
    before = evaluate.evaluate(ball)
    injured = []
    for view in ball.scene.views:
        picture = images.read(view.image)
        light = images.linear_from_srgb(picture[..., :3]) * np.array([1.8, 1.5, 1.3])
        path = ball.run.path / f"{view.name}_bright.png"
        images.write(path, np.concatenate([images.srgb_from_linear(light).clip(0, 1), picture[..., 3:]], -1))
        injured.append(replace(view, image=path))
    bright = replace(ball, scene=ball.scene.with_views(tuple(injured)))
    with_gains = replace(bright, model=replace(ball.model, per_image=jnp.zeros((4, 3))))
    fixed, exposed = evaluate.evaluate(bright), evaluate.evaluate(with_gains)
    assert "exposure" not in fixed and "log_gains" not in fixed["per_view"][0]
    assert fixed["mean"]["psnr"] < before["mean"]["psnr"] - 3, "the premise: exposure is seen"
    assert exposed["mean"]["psnr"] > before["mean"]["psnr"]  # a brighter ball differs less from white, so its rim errs less
    assert exposed["exposure"]["psnr_as_rendered"] == pytest.approx(fixed["mean"]["psnr"], abs=1e-6)
    for view in exposed["per_view"]:
        np.testing.assert_allclose(view["log_gains"], [np.log([1.8, 1.5, 1.3])] * 2, atol=0.05)
    assert "one half" in exposed["exposure"]["definitions"]["exposure"] and "one half" in evaluate.table(exposed)
