from pathlib import Path

import numpy as np

from datasets.checks.evidence import Evidence
from datasets.injuries import bench
from datasets.injuries.injure import INJURIES, gap, wrong_box, wrong_focal
from datasets.injuries.studio import Studio, write


def test_the_table_counts_what_is_named(tmp_path: Path) -> None:
    scene = write(Studio(views=14, width=160, height=120), tmp_path)
    some = [one for one in INJURIES if one.name in ("pose", "mask eroded")]
    found = list(bench.trials([scene], injuries=some, lights=False))
    assert [trial.strength for trial in found if trial.injury == "pose"] == [1, 3, 10]
    assert not [trial for trial in found if trial.injury == "mask eroded"], "the studio with its table has no masks"
    assert all(trial.named for trial in found if trial.injury == "pose" and trial.strength > 1)
    text = bench.table(found)
    assert "pose" in text and "10 px: 1/1" in text and "untouched studio" in text


def test_features_seen_again_are_those_of_the_new_cameras(tmp_path: Path) -> None:
    scene = write(Studio(views=6, width=120, height=90), tmp_path)
    known = Evidence.gather(scene)
    injured, _ = wrong_focal(scene, 10.0, tmp_path)
    again, fresh = bench.seen_again(known, injured), Evidence.gather(injured)
    for one, other in zip(again.matches.features, fresh.matches.features, strict=True):
        assert np.abs(one.directions - other.directions).max() < 1e-9


def test_geometric_injuries_do_what_they_say(tmp_path: Path) -> None:
    scene = write(Studio(views=12, width=24, height=18), tmp_path)
    alone = gap(scene, 40.0, tmp_path)[1]
    assert len(alone) == 1 and len(gap(scene, 100.0, tmp_path)[0].views) < len(gap(scene, 40.0, tmp_path)[0].views) < 12
    moved, _ = wrong_box(scene, 50.0, tmp_path)
    assert np.abs(moved.box - scene.box).max() == 0.5 * (scene.box[1] - scene.box[0]).max()
    assert {one.cause for one in INJURIES} >= {"pose", "intrinsics", "exposure", "blur", "mask", "motion", "coverage", "box"}
