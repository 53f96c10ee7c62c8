import numpy as np

from koala3d.reconstruct.convergence import early_warning, figures_of, find, got_worse


def log(train: np.ndarray, unseen: np.ndarray | None = None, every_s: float = 5.0) -> list[dict]:
    lines = [{"step": 100 * k, "seconds": every_s * k, "psnr_train": float(value)} for k, value in enumerate(train, 1)]
    for line, value in zip(lines, unseen if unseen is not None else (), strict=False):
        line["psnr_unseen"] = float(value)
    return lines


STEPS = np.arange(1, 13)
GOOD = 18 + 4 * np.log(STEPS) + np.random.default_rng(0).normal(0, 0.5, 12)


def test_a_training_that_improves_has_no_findings() -> None:
    assert find(log(GOOD, GOOD - 1)) == [] and early_warning(log(GOOD[:6], GOOD[:6] - 1)) is None


def test_a_training_that_stands_still_is_named() -> None:
    (found,) = find(log(np.full(12, 11.0)))
    assert found.what == "training does not converge" and found.cause == "training" and "datasets check" in found.remedy


def test_a_training_that_falls_is_named() -> None:
    (found,) = find(log(np.concatenate([GOOD[:6], GOOD[:6] - 8])))
    assert found.what == "training diverges" and "train.rate" in found.remedy


def test_over_fitting_is_named_only_where_unseen_views_get_worse() -> None:
    falling = np.concatenate([GOOD[:5], GOOD[4] - 0.4 * np.arange(1, 8)])
    (found,) = find(log(GOOD + 3, falling))
    assert found.what == "training over-fits" and found.evidence["behind_db"] > 3
    assert find(log(GOOD + 4, GOOD)) == []


def test_unseen_views_that_were_better_before_are_named() -> None:
    rising = 18 + 4 * np.log(STEPS)
    assert got_worse(log(GOOD, rising)) == [] == got_worse(log(GOOD)) and got_worse([]) == []
    torn = np.where(STEPS > 6, rising - 4, rising)
    (found,) = got_worse(log(GOOD, torn))
    assert found.what == "unseen views got worse" and "after 500 steps" in found.why and "train.seed" in found.remedy
    alone = rising.copy()
    alone[3] += 9
    assert got_worse(log(GOOD, alone)) == [], "one line is noise"


def test_the_beginning_is_enough_but_not_its_first_seconds() -> None:
    assert early_warning(log(np.full(3, 11.0))) is None, "too early"
    assert early_warning(log(np.full(8, 11.0))) is None, "said before"
    words = early_warning(log(np.full(6, 11.0)))
    assert words is not None and words.startswith("warning: ") and "\n" not in words
    assert find(log(np.concatenate([np.full(8, 11.0), GOOD + 5]))) == [] and find([]) == []


def test_figures_are_those_of_the_line() -> None:
    assert figures_of({"psnr_train": 21.26, "seconds": 3.0}) == "PSNR 21.3 dB" and figures_of({}) == ""
