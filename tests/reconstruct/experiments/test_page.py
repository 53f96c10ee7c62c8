"""The page says what was trained, what it gained, what it cost, and where."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from koala3d.reconstruct.experiments import comparison, page
from koala3d.reconstruct.experiments.results import Origin, Result

MACHINE = {"machine": "a <processor>", "cores": 2, "load": 0.5, "commit": "abc"}


def result(setting: str, seed: int, psnr: float, budget_s: float = 15.0) -> Result:
    origin = Origin("surfnerf", "fast", setting, budget_s)
    return Result(Path(f"seed_{seed}"), "ball", origin, seed, {}, {"mean": {"psnr": psnr}}, {"steps": 1234.0}, MACHINE)


def test_everything_is_on_the_page() -> None:
    results = [result("base", 0, 25.0), result("base", 1, 27.0), result("without bias", 0, 24.0), result("base", 0, 28.0, 30.0)]
    text = page.of_results("study", results, settings={"surfnerf, without bias": ["surface.bias=0"]})
    for words in (
        "26.0 ± 1.4",
        "surfnerf, without bias",
        "surface.bias=0",
        "1234",
        "a &lt;processor&gt;, 2 cores",
        "95 % confidence",
    ):
        assert words in text, words
    assert text.count("<svg") == 2  # gains at 15 s, and the curve
    alone = page.of_results("study", [replace(results[0], machine={}, work={})])
    assert "<svg" not in alone and "25.00" in alone


def test_a_comparison_begins_with_what_is_clear(make_row: Callable) -> None:
    differences = comparison.compare([make_row()], [make_row(normal_mae_alpha_acc_deg=20.0)])
    text = page.of_comparison("one against the other", differences)
    assert text.index("<td>worse") < text.index("<td>noise") and "false alarms" in text
