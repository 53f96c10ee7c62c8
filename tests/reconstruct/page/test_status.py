"""What the page of a run says of its training."""

from collections.abc import Callable
from typing import Any

import numpy as np

from koala3d.reconstruct.page.status import curves, skips_text, status_text
from koala3d.reconstruct.training.decisions import record
from koala3d.reconstruct.training.decisions.skip import Skip


def test_the_log_is_told_in_words_and_curves(make_run: Callable[..., Any]) -> None:
    run = make_run()
    words = status_text(run.log(), run)
    assert "step 2 after 2 s" in words and "test views 11.00 dB" in words and "made for a test" in words
    assert "gradient" not in words, "where every gradient was finite, nobody needs to know of it"
    assert "3 steps skipped because their gradient" in status_text([{**run.log()[-1], "skipped": 3}], run)
    (seconds, train, unseen), series = curves([*run.log(), {"seconds": 3.0, "psnr_train": 13.0}])
    assert seconds.tolist() == [0, 1, 2, 3] and train[-1] == 13 and np.isnan(unseen[-1]) and len(series) == 3
    assert status_text([], run) == "*the log is empty*"


def test_skips_are_listed_with_their_evidence(make_run: Callable[..., Any]) -> None:
    run = make_run()
    (run.path / record.SKIPS).unlink(missing_ok=True)
    assert skips_text(run) == ""
    empty = Skip("empty_rays", "empty space", True, "masks rule out 80% of the space", "samples in there")
    reflection = Skip("reflection", "reflections of a matte object", False, "5% of the object keeps its colour", "half a step")
    record.write(run.path, [empty, reflection])
    words = skips_text(run)
    assert words.startswith("- **empty space** skipped: masks rule out 80% of the space") and "saves samples in there" in words
    assert words.endswith("- reflections of a matte object kept: 5% of the object keeps its colour")
