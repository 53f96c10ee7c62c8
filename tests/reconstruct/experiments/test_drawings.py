"""What the curves are made of."""

from collections.abc import Callable
from xml.etree import ElementTree

from koala3d.reconstruct.bench import drawings


def test_spread_is_mean_and_extremes_of_each_budget(make_row: Callable) -> None:
    rows = [make_row(psnr=value, seed=float(seed), budget_s=budget)
            for budget, values in ((30.0, (26.0, 28.0)), (15.0, (25.0,))) for seed, value in enumerate(values)]  # fmt: skip
    assert drawings.spread([*rows, make_row(budget_s=60.0, psnr=None)], "psnr") == [(15, 25, 25, 25), (30, 27, 26, 28)]


def test_the_front_is_what_nothing_beats() -> None:
    points = [(15, 20), (30, 25), (30, 22), (60, 24), (120, 26)]
    assert drawings.front(points, higher=True) == [(15, 20), (30, 25), (120, 26)]
    assert drawings.front(points, higher=False) == [(15, 20)]
    assert drawings.front([], higher=True) == []


def test_drawings_are_whole(make_row: Callable) -> None:
    same = [make_row(seed=float(seed), psnr=38.53842131961673) for seed in range(3)]  # whose mean may be less than all of them
    rows = [*same, make_row(budget_s=30.0, psnr=27.0), make_row(model="zipnerf", psnr=24.0)]
    peer = {"program": "other", "scene": "chrome_ball", "scale": 1.0, "seconds": 40.0, "psnr": 10.0}
    for svg in (
        drawings.pareto(rows, [peer]),
        drawings.parts([["samples", "encoding", "forward", 1.5], ["optimiser", "optimiser", "forward", 0.5]]),
    ):
        assert ElementTree.fromstring(svg).tag.endswith("svg")
