"""What differs between two sweeps, and what they do not share."""

from collections.abc import Callable

import numpy as np
import pytest

from koala3d.reconstruct.experiments import comparison
from koala3d.reconstruct.experiments.comparison import EVERYWHERE


def test_only_what_both_have_is_compared(make_row: Callable) -> None:
    before, after = [make_row(), make_row("teapot", psnr=30.0)], [make_row(psnr=26.0), make_row(setting="without bias")]
    (one,) = comparison.compare(before, after, ("psnr", "chamfer_mm"))
    assert (one.place, one.figure, one.verdict) == ("chrome_ball, surfnerf, fast, 15 s", "psnr", "better")
    assert one.change.value == pytest.approx(1.0) and one.change.low > 0
    told = comparison.summary([one])
    assert told["tested"] == 1 and told["expected_false_alarms"] == 0.05
    assert "better" in comparison.text([one]) and "1 of 1" in comparison.text([one])


def test_fewer_rays_per_second_and_more_degrees_are_worse(make_row: Callable) -> None:
    after = make_row(rays_per_s=40_000.0, normal_mae_alpha_acc_deg=12.0)
    found = comparison.compare([make_row()], [after], ("psnr", "rays_per_s", "normal_mae_alpha_acc_deg"))
    assert [one.verdict for one in found] == ["noise", "worse", "worse"]


def test_small_changes_everywhere_are_seen_over_all_places(make_row: Callable) -> None:
    rng = np.random.default_rng(1)
    rows = lambda gain: [make_row(f"scene{n}", psnr=25 + gain + rng.normal(0, 0.05)) for n in range(8)]  # noqa: E731
    found = comparison.compare(rows(0.0), rows(0.2), ("psnr",))
    assert found[0].place == EVERYWHERE and found[0].verdict == "better" and len(found) == 9
    assert all(one.verdict == "noise" for one in found[1:])
