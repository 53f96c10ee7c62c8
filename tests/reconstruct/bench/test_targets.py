"""Targets are met, missed, or not known."""

from collections.abc import Callable

from koala3d.reconstruct.bench.targets import SHINY, outcomes


def test_mean_over_scenes_and_seeds(make_row: Callable) -> None:
    lego = [make_row(scene="lego400", scale=0.5, budget_s=60.0, seed=float(seed), psnr=28.9 + 0.3 * seed) for seed in range(2)]
    (one,) = [one for one in outcomes(lego) if one.target.metric == "psnr"]
    assert one.met is True and one.seeds == 2 and abs(one.reached - 29.05) < 1e-9
    shiny = [make_row(scene=scene, budget_s=120.0, normal_mae_alpha_acc_deg=9.0, normal_mae_deg=None) for scene in SHINY]
    assert [one.met for one in outcomes(shiny)] == [False]
    assert [one.met for one in outcomes(shiny[:3])] == [None]
    assert outcomes([make_row(kind="cost", scene="lego400", scale=0.5, budget_s=60.0)]) == []
