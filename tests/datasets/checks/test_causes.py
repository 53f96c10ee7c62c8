"""Each cause is named in pictures of two textured walls, and nothing is named in untouched ones."""

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.checks import blur, coverage, exposure, intrinsics, motion, single_poses
from koala3d.datasets.checks.evidence import Evidence
from koala3d.datasets.checks.matches import check_evidence
from koala3d.datasets.core.findings import Finding
from koala3d.datasets.scene import Scene
from koala3d.datasets.structure.epipolar import Correction
from koala3d.datasets.structure.exposure import ExposureGains
from koala3d.datasets.structure.matching import Matches
from koala3d.datasets.structure.triangulate import agreement
from tests.bench import injure
from tests.bench.check import seen_again

LENS = Camera(320, 240, 340.0, 340.0, 160.0, 120.0)


@pytest.fixture
def walls(two_walls: Callable[..., Scene]) -> Scene:
    return two_walls(LENS)


@pytest.fixture(scope="module")
def known(painted_walls: Callable[[Camera], Scene]) -> Evidence:
    """That of untouched pictures."""
    return Evidence.gather(painted_walls(LENS))


def named(found: list[Finding], cause: str) -> set[str]:
    """Views that findings of one cause name; {""} where they name the cause alone."""
    own = [finding for finding in found if finding.cause == cause]
    return {name for finding in own for name in finding.evidence.get("views", {"": 0})}


def test_untouched_pictures_have_no_findings(known: Evidence) -> None:
    assert check_evidence(known) == []


def test_single_poses_are_named(known: Evidence, tmp_path) -> None:
    injured, hurt = injure.moved_poses(known.scene, 3.0, tmp_path)
    found = check_evidence(seen_again(known, injured))
    assert named(found, "pose") == hurt and {finding.cause for finding in found} == {"pose"}
    sizes = [size for finding in found for size in finding.evidence["views"].values()]
    assert all(1.5 < size < 4.5 for size in sizes)  # it was moved by 3 px; what its matches do not fix stays


def mirrored(evidence: Evidence, share: float) -> Evidence:
    """Evidence of which a share of the matches leads elsewhere, as those of reflections do."""
    random, pairs = np.random.default_rng(3), []
    for first, second, matched in evidence.matches.pairs:
        other = matched.copy()
        wrong = np.flatnonzero(random.random(len(matched)) < share)
        other[wrong, 1] = other[np.roll(wrong, 1), 1]
        pairs.append((first, second, other))
    return replace(evidence, matches=Matches(evidence.matches.views, evidence.matches.features, tuple(pairs)))


def test_no_single_pose_is_accused_where_most_matches_fit_no_pose(known: Evidence, tmp_path) -> None:
    injured, hurt = injure.moved_poses(known.scene, 3.0, tmp_path)
    for share, expected in ((0.2, hurt), (0.75, set())):
        evidence = mirrored(seen_again(known, injured), share)
        assert (agreement(evidence.matches, evidence.matrices) > 0.5) == bool(expected)
        assert named(single_poses.find(evidence), "pose") == expected


def test_a_distortion_that_no_lens_has_is_not_named(known: Evidence, monkeypatch: pytest.MonkeyPatch) -> None:
    evidence = known
    for share, count in ((0.1, 1), (0.45, 0)):
        change = np.array([0.0, share / intrinsics.edge(evidence) ** 2, 0.0, 0.0])
        fit = Correction(change[1:2], np.ones(1), gain=0.1, inliers=10**6, before_px=1.0, after_px=0.3)
        monkeypatch.setattr(intrinsics, "best", lambda _, found=("distortion", change, fit): found)
        monkeypatch.setattr(intrinsics, "_everywhere", lambda *_: True)
        assert len(intrinsics.find(evidence)) == count


def test_a_wrong_distortion_is_named_for_all_views(known: Evidence, tmp_path) -> None:
    injured, _ = injure.wrong_distortion(known.scene, 6.0, tmp_path)
    (found,) = [one for one in check_evidence(seen_again(known, injured)) if one.cause == "intrinsics"]
    assert found.where == "all views" and "distortion" in found.what
    true = known.views[0].camera.k1 - injured.views[0].camera.k1
    assert found.evidence["change"][1] == pytest.approx(true, rel=0.2)


def test_blurred_views_are_named_with_their_blur(walls: Scene, tmp_path) -> None:
    injured, hurt = injure.blurred(walls, 2.5, tmp_path)
    found = blur.find(Evidence.gather(injured))
    assert named(found, "blur") == hurt
    sizes = [size for one in found if one.cause == "blur" for size in one.evidence["views"].values()]
    assert all(1.5 < size < 3.5 for size in sizes)


def test_exposure_and_white_balance_are_told_apart(walls: Scene, tmp_path) -> None:
    darker, hurt = injure.wrong_exposure(walls, 0.6, tmp_path)
    found = exposure.find(Evidence.gather(darker))
    assert named(found, "exposure") == hurt and not named(found, "white balance")
    assert {round(gain, 1) for gain in found[0].evidence["views"].values()} == {0.6}
    warmer, hurt = injure.wrong_white(walls, 1.4, tmp_path / "white")
    found = exposure.find(Evidence.gather(warmer))
    assert named(found, "white balance") == hurt and not named(found, "exposure")


def test_a_thing_that_moves_is_named_with_its_region(walls: Scene, tmp_path) -> None:
    injured, _ = injure.moving_thing(walls, 35.0, tmp_path)
    (found,) = motion.find(Evidence.gather(injured))
    assert found.evidence["matches"] >= motion.FEWEST and len(found.evidence["regions"]) >= 6
    for left, top, right, bottom in found.evidence["regions"].values():
        assert 0 <= left < right <= 320 and 0 <= top < bottom <= 240


def test_coherent_matches_are_told_from_random_ones() -> None:
    random = np.random.default_rng(0)
    a = random.uniform(0, 300, (60, 2))
    turned = a @ np.array([[0.9, 0.2], [-0.2, 0.9]]) + 40
    scattered = random.uniform(0, 300, (60, 2))
    assert motion.coherent(a, turned, 100).mean() > 0.9
    assert motion.coherent(a, scattered, 100).mean() < 0.05
    assert not motion.coherent(a[:3], turned[:3], 100).any()


def test_a_view_without_neighbours_is_named(walls: Scene) -> None:
    angles = np.deg2rad([*range(0, 200, 10), 270])
    views = tuple(
        replace(walls.views[0], name=f"{k}", world_from_camera=pose.look_at((4 * np.cos(a), 4 * np.sin(a), 1), (0, 0, 0)))
        for k, a in enumerate(angles)
    )
    (found,) = coverage.find(walls.with_views(views))
    assert "20" in found.evidence["views"] and found.cause == "coverage"
    assert coverage.find(walls.with_views(views[:20])) == []
    assert coverage.find(walls.with_views(views[::7]))[0].what == "views are too far apart"


def test_a_view_without_measured_light_is_not_in_the_figures() -> None:
    """JSON has no NaN: a NaN there made 'datasets check --json' end with a traceback in a series."""
    gains = np.zeros((6, 3))
    gains[1], gains[4] = np.log(0.5), np.nan
    gains[5, 0] = np.nan
    measured = ExposureGains(tuple("abcdef"), gains, np.where(np.isnan(gains), np.nan, 0.01), np.full(6, 50))
    (finding,) = exposure._exposure(measured)
    assert finding.evidence["views"] == {"b": pytest.approx(0.5)} and list(finding.evidence["gains"]) == list("abcd")
    json.dumps(finding.evidence, allow_nan=False)
