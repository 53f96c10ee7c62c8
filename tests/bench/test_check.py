from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.checks.evidence import Evidence
from koala3d.datasets.imaging import images
from tests.bench import check
from tests.bench.injure import INJURIES, gap, shown, whole, wrong_box, wrong_distortion, wrong_focal
from tests.bench.studio import Studio, write


def test_the_table_counts_what_is_named(tmp_path: Path) -> None:
    scene = write(Studio(views=14, width=160, height=120), tmp_path)
    some = [one for one in INJURIES if one.name in ("pose", "mask eroded")]
    found = list(check.trials([scene], injuries=some, lights=False))
    assert [trial.strength for trial in found if trial.injury == "pose"] == [1, 3, 10]
    assert not [trial for trial in found if trial.injury == "mask eroded"], "the studio with its table has no masks"
    assert all(trial.named for trial in found if trial.injury == "pose" and trial.strength > 1)
    text = check.table(found)
    assert "pose" in text and "10 px: 1/1" in text and "untouched studio" in text


def test_features_seen_again_are_those_of_the_new_cameras(tmp_path: Path) -> None:
    scene = write(Studio(views=6, width=120, height=90), tmp_path)
    known = Evidence.gather(scene)
    injured, _ = wrong_focal(scene, 10.0, tmp_path)
    again, fresh = check.seen_again(known, injured), Evidence.gather(injured)
    for one, other in zip(again.matches.features, fresh.matches.features, strict=True):
        assert np.abs(one.directions - other.directions).max() < 1e-9


def test_geometric_injuries_do_what_they_say(tmp_path: Path) -> None:
    scene = write(Studio(views=12, width=24, height=18), tmp_path)
    alone = gap(scene, 40.0, tmp_path)[1]
    assert len(alone) == 1 and len(gap(scene, 100.0, tmp_path)[0].views) < len(gap(scene, 40.0, tmp_path)[0].views) < 12
    moved, _ = wrong_box(scene, 50.0, tmp_path)
    assert np.abs(moved.box - scene.box).max() == 0.5 * (scene.box[1] - scene.box[0]).max()
    assert {one.cause for one in INJURIES} >= {"pose", "intrinsics", "exposure", "blur", "mask", "motion", "coverage", "box"}


def test_distortion_is_measured_where_the_object_is_and_cut_masks_are_spared(tmp_path: Path) -> None:
    scene = write(Studio(views=6, width=64, height=48, table=False), tmp_path)
    assert 0.2 < shown(scene) < 0.9 and whole(scene) == [0, 1, 2, 4, 5]  # in view 3 it touches the edge
    injured, _ = wrong_distortion(scene, 2.0, tmp_path)
    half = shown(scene) * 32 / scene.views[0].camera.fx
    assert -injured.views[0].camera.k1 * half**3 * scene.views[0].camera.fx == pytest.approx(
        2.0, rel=0.2
    )  # the edge is measured from the principal point
    for view in scene.views[:5]:
        images.write(view.image, np.ones((48, 64, 4), np.float32))  # the object fills the picture
    assert whole(scene) == [5] and not check.fits(next(one for one in INJURIES if one.name == "mask shifted"), scene)
