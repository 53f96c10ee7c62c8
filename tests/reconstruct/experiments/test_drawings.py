"""What the drawings are made of."""

from collections.abc import Callable
from xml.etree import ElementTree

from koala3d.reconstruct.experiments import drawings


def test_a_curve_is_mean_and_deviation_of_each_budget(make_row: Callable) -> None:
    rows = [make_row(budget_s=30.0, psnr=27.0), make_row(), make_row(budget_s=60.0, psnr=None)]
    assert drawings.curve(rows, "psnr") == [(15, 25, 0.1), (30, 27, 0.1)]


def test_the_front_is_what_nothing_beats() -> None:
    points = [(15, 20), (30, 25), (30, 22), (60, 24), (120, 26)]
    assert drawings.front(points, higher=True) == [(15, 20), (30, 25), (120, 26)]
    assert drawings.front(points, higher=False) == [(15, 20)]
    assert drawings.front([], higher=True) == []


def test_drawings_are_whole(make_row: Callable) -> None:
    rows = [make_row(), make_row(budget_s=30.0, psnr=27.0), make_row(model="zipnerf", psnr=24.0)]
    for svg in (drawings.curves(rows), drawings.gains(rows[0], rows[1:])):
        assert ElementTree.fromstring(svg).tag.endswith("svg")
