"""Rig files."""

import numpy as np
import pytest

from koala3d.capture.model.rig import RigDescription, load_rig
from koala3d.capture.planning import Obstacles
from koala3d.capture.rig.naming import describe
from koala3d.datasets.core.errors import UsageError


def test_the_shipped_rig_is_the_default_one():
    rig = describe("ur5e_basler")
    assert rig == RigDescription()
    mount = rig.flange_from_camera.matrix()
    np.testing.assert_allclose(mount[:3, 3], [0, 0.06, 0.08])
    np.testing.assert_allclose(mount[:3, 2], [0, -np.sqrt(0.5), np.sqrt(0.5)], atol=1e-12)  # looks across the tool axis


def test_a_wrong_key_is_named(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text("robot:\n  hots: 10.0.0.1\n")
    with pytest.raises(UsageError, match=r"line 2: unknown key 'robot.hots'; did you mean 'host'\?"):
        load_rig(path)


PAIR = """\
cameras:
  near:
    model: basler
    serial: "1"
    flange_from_camera: {position: [0.0, 0.06, 0.08], rotation_deg: [45, 0, 0]}
  far:
    model: opencv
    serial: "2"
    leave: [gain_db]
    radiometry: flat.npz
    flange_from_camera: {position: [0.06, 0.06, 0.08], rotation_deg: [45, 0, 0]}
"""


@pytest.fixture
def pair(tmp_path):
    path = tmp_path / "pair.yaml"
    path.write_text(PAIR)
    return path


def test_several_cameras_are_one_rig_for_each(pair):
    rig = load_rig(pair)
    assert list(rig.each) == ["near", "far"] and rig.each["near"] == rig and rig.name == "near"
    far = rig.each["far"]
    assert (far.name, far.camera.model, far.camera.leave) == ("far", "opencv", ["gain_db"])
    assert far.camera.radiometry == str(pair.parent / "flat.npz")  # beside the rig file
    assert far.flange_from_camera.position == (0.06, 0.06, 0.08)
    for one in (rig, far):  # as a manifest stores it
        assert RigDescription.model_validate(one.model_dump(mode="json")) == one
    alone = RigDescription()
    assert alone.each == {"": alone} and alone.name == ""


def test_no_camera_may_touch_anything(pair):
    rig = load_rig(pair)
    one, both = RigDescription().carrier(), rig.carrier()
    assert [part.name for part in both.shape.parts[-4:]] == ["far bracket", "far lens", "far camera", "far plug"]
    assert [part.name for part in both.shape.parts[:-4]] == [part.name for part in one.shape.parts]
    shape = rig.each["far"].carrier().shape
    (lens,) = [part for part in shape.parts if part.name == "near lens"]
    np.testing.assert_allclose(lens.start, one.shape.parts[one.shape.index["lens"]].start)
    home = one.arm.home[None]
    margins = Obstacles(both, 0.02, table_z=0.0).margins(home)
    assert "far lens to table" in margins and set(Obstacles(one, 0.02, table_z=0.0).margins(home)) < set(margins)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("  far:", "  near:", "near"),
        ("  far:", "  'far/off':", "far/off"),
        ('"2"', '"1"', "'near' and 'far' have the same serial"),
        ("[0.06, 0.06", "[0.0, 0.06", "'near' and 'far' have the same flange_from_camera"),
        ("cameras:", "camera: {serial: '3'}\ncameras:", "'cameras' lists every camera, and this is none of them: remove camera"),
        ("cameras:", "beside: {base_from_camera: {position: [1, 0, 0]}}\ncameras:", "remove 'cameras' or 'beside'"),
        ("leave: [gain_db]", "depth: {width: 64}", "depth means nothing to opencv"),
        ('serial: "2"', "serail: '2'", "unknown key 'cameras.far.serail'; did you mean 'serial'?"),
    ],
)
def test_cameras_that_do_not_fit_together_are_refused(pair, old, new, words):
    text = pair.read_text()
    assert old in text
    pair.write_text(text.replace(old, new, 1))
    with pytest.raises(UsageError) as caught:
        load_rig(pair)
    assert words in str(caught.value) and str(caught.value).startswith(str(pair)), caught.value
