"""Trajectory files: the ones that we ship load, and every mistake in one names its place."""

from collections import Counter

import numpy as np
import pytest

from koala3d.capture.model.shapes.geometry import Box
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.datasets.core.errors import UsageError

SMALL = """\
name: small
views:
  - kind: orbit
    target: [0.4, 0.0, 0.1]
    distance: 0.4
    count: 10
split: {train: 8, test: 2}
"""


def _load(tmp_path, text):
    path = tmp_path / "small.yaml"
    path.write_text(text)
    return load_trajectory(path)


@pytest.mark.parametrize(
    ("name", "splits"),
    [
        ("koala_demo", {"train": 40, "test": 10}),
        ("koala_fine", {"train": 59, "test": 15}),
        ("koala_metre", {"train": 56, "test": 14}),
        ("koala_hanging", {"train": 80, "test": 20}),
        ("koala", {"train": 40, "test": 10}),
        ("calibration_demo", {"calibration": 25}),
        ("calibration_hanging", {"calibration": 25}),
    ],
)
def test_shipped_files_load(name, splits):
    trajectory = load_trajectory(name)
    viewpoints = trajectory.viewpoints()
    assert Counter(view.split for view in viewpoints) == splits
    names = [view.name for view in viewpoints]
    assert names == sorted(set(names)) and names[0] == "000"


def test_the_same_file_gives_the_same_views():
    path = "calibration_demo"
    first, second = load_trajectory(path).viewpoints(), load_trajectory(path).viewpoints()
    assert all((a.base_from_camera == b.base_from_camera).all() for a, b in zip(first, second, strict=True))


def test_test_views_lie_between_training_views(tmp_path):
    splits = _load(tmp_path, SMALL).splits
    assert splits == ["train", "train", "test", "train", "train", "train", "train", "test", "train", "train"]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("count: 10", "cuont: 10"), ["line 6", "unknown key 'views.0.cuont'", "did you mean 'count'?"]),
        (("split:", "splits:"), ["line 7", "unknown key 'splits'", "did you mean 'split'?"]),
        (("count: 10", "count: 11"), ["split has 8 + 2 views, but 'views' gives 11"]),
        (("kind: orbit", "kind: circle"), ["line 3", "'circle'"]),
        (("distance: 0.4", "distance: -0.4"), ["line 5", "distance", "given: -0.4"]),
        (("distance: 0.4", "distance: 0.4\n    distance: 0.5"), ["line 6", "given twice"]),
        (("name: small", "name: ../small"), ["line 1", "name"]),
        (("name: small", "name: small\nup: z"), ["line 2", "up", "'z'"]),
        (("name: small", "name: small\nup: -z"), ["with up: -z the table has a positive z", "safety.table_z is 0"]),
        (("name: small", "name: small\nsafety: {ceiling_z: -1}"), ["safety.ceiling_z -1 is not above safety.table_z 0"]),
        (
            ("name: small", "name: small\nup: -z\nsafety: {table_z: 1, ceiling_z: 2}"),
            ["ceiling_z 2 is not above safety.table_z 1"],
        ),
    ],
)
def test_mistakes_are_named(tmp_path, change, expected):
    assert SMALL.count(change[0]) == 1
    with pytest.raises(UsageError) as caught:
        _load(tmp_path, SMALL.replace(*change))
    assert [part for part in expected if part not in str(caught.value)] == []


def test_the_table_is_where_the_trajectory_says(tmp_path):
    np.testing.assert_array_equal(_load(tmp_path, SMALL).base_from_table, np.eye(4))
    pedestal = _load(tmp_path, SMALL + "safety: {table_z: -0.4}\n").base_from_table
    np.testing.assert_allclose(pedestal @ [0.1, 0.2, 0, 1], [0.1, 0.2, -0.4, 1])
    hanging = _load(tmp_path, SMALL + "up: -z\nsafety: {table_z: 1.2}\n").base_from_table
    np.testing.assert_allclose(hanging @ [0.1, 0.2, 0.3, 1], [0.1, -0.2, 0.9, 1])  # 0.3 m above the table
    assert np.linalg.det(hanging[:3, :3]) == pytest.approx(1)


def test_a_target_session_has_no_split(tmp_path):
    target = "target: {kind: charuco, squares_x: 9, squares_y: 7, square_length_m: 0.03, marker_length_m: 0.022}\n"
    with pytest.raises(UsageError, match="a session with a target has no split"):
        _load(tmp_path, SMALL + target)
    assert set(_load(tmp_path, SMALL.replace("split: {train: 8, test: 2}\n", target)).splits) == {"calibration"}


def test_a_target_is_given_by_its_keys_or_by_its_name_and_placed_by_corner_or_middle(tmp_path):
    place = "board: {position: [0.4, 0.0, 0.003], rotation_deg: [180, 0, 0], at: middle}\n"
    found = _load(tmp_path, SMALL.replace("split: {train: 8, test: 2}\n", f"target: charuco\n{place}"))
    assert (found.target.kind, found.target.squares_x) == ("charuco", 9)
    np.testing.assert_allclose(found.base_from_board[:3, 3], [0.265, 0.105, 0.003], atol=1e-12)
    np.testing.assert_allclose(found.base_from_middle[:3, 3], [0.4, 0.0, 0.003], atol=1e-12)
    with pytest.raises(UsageError, match=r"no calibration target 'charucco'.*did you mean 'charuco'"):
        _load(tmp_path, SMALL.replace("split: {train: 8, test: 2}\n", "target: charucco\n"))


def test_box_corners():
    np.testing.assert_allclose(Box(centre=(1, 2, 3), size=(0.2, 0.4, 0.6)).corners, [[0.9, 1.8, 2.7], [1.1, 2.2, 3.3]])
    with pytest.raises(ValueError, match="positive"):
        Box(centre=(0, 0, 0), size=(1, 0, 1))


GROUP = """\
name: one
views:
  - {kind: orbit, target: [0.4, 0.0, 0.1], distance: 0.4, count: 2}
"""


@pytest.mark.parametrize(
    ("group", "expected"),
    [
        ("{kind: hemisphere, target: [0.4, 0, 0.1], distance: 0.4, count: 3, rings: 4}", "4 rings need at least as many views"),
        (
            "{kind: hemisphere, target: [0.4, 0, 0.1], distance: 0.4, count: 9, elevation_deg: [70, 20]}",
            "elevation_deg must rise",
        ),
        ("{kind: orbit, target: [0.4, 0, 0.1], distance: 0.4, count: 2, roll_deg: []}", "roll_deg"),
        ("{kind: orbit, target: [0.4, 0], distance: 0.4, count: 2}", "views.0.target"),
        ("{kind: orbit, target: [0.4, 0, .inf], distance: 0.4, count: 2}", "views.0.target"),
        ("{kind: orbit, target: [0.4, 0, 0.1], distance: 5, count: 2}", "given: 5"),
        ("{kind: grid, target: [0.4, 0, 0.1], centre: [0.4, 0, 0.5], size: [0.1, 0.1], columns: 0, rows: 2}", "columns"),
        ("{kind: poses, poses: []}", "views.0.poses"),
        ("{kind: poses, poses: [{position: [0.4, 0, 0.1]}]}", "give either look_at or quaternion_wxyz"),
        ("{kind: poses, poses: [{position: [0.4, 0, 0.1], look_at: [0.4, 0, 0.1]}]}", "position and look_at coincide"),
        ("{kind: joints, joints_deg: [[]]}", "joints_deg"),
        ("{target: [0.4, 0, 0.1]}", "kind"),
    ],
)
def test_a_wrong_group_of_views_is_named(tmp_path, group, expected):
    with pytest.raises(UsageError, match=r"small\.yaml, line \d+") as caught:
        _load(tmp_path, f"name: one\nviews:\n  - {group}\n")
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("camera.binning=0", "camera.binning"),
        ("camera.exposure_us=-1", "camera.exposure_us"),
        ("camera.pixel_format=rgb16", "'rgb8', 'bayer8', 'bayer12', 'mono8' or 'mono12'"),
        ("camera.pixelformat=rgb8", "did you mean 'pixel_format'?"),
        ("motion.speed=4", "motion.speed"),
        ("motion.order=fastest", "'given' or 'shortest'"),
        ("motion.settle_difference=1", "motion.settle_difference"),
        ("safety.clearance_m=1", "safety.clearance_m"),
        ("views.1.count=3", "items are numbered from 0 to 0"),
        ("name=a b", "name"),
        ("version=2", "version"),
    ],
)
def test_a_wrong_override_is_named(tmp_path, setting, expected):
    path = tmp_path / "one.yaml"
    path.write_text(GROUP)
    load_trajectory(path)  # the premise: without the override it is right
    with pytest.raises(UsageError) as caught:
        load_trajectory(path, overrides=[setting])
    assert expected in str(caught.value) and "\n" not in str(caught.value)


def test_overrides_change_what_they_name_and_nothing_else():
    plain, changed = (
        load_trajectory("koala_demo"),
        load_trajectory("koala_demo", overrides=["views.0.distance=0.5", "motion.speed=0.3"]),
    )
    assert changed.model_dump()["views"][0]["distance"] == 0.5 and changed.motion.speed == 0.3
    same = changed.model_dump() | {"views": plain.model_dump()["views"], "motion": plain.model_dump()["motion"]}
    assert same == plain.model_dump()


def test_an_unknown_name_lists_what_there_is():
    with pytest.raises(UsageError, match=r"no trajectory 'koala_dmo' \(known: calibration, .*\); did you mean 'koala_demo'\?"):
        load_trajectory("koala_dmo")
    with pytest.raises(UsageError, match=r"koala_dmo\.yaml: no such file"):
        load_trajectory("koala_dmo.yaml")


def test_names_have_as_many_digits_as_they_need(tmp_path):
    many = GROUP.replace("count: 2", "count: 1001")
    names = [view.name for view in _load(tmp_path, many).viewpoints()]
    assert (names[0], names[-1]) == ("0000", "1000") and names == sorted(names)
