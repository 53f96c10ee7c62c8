"""The contract of camera drivers on the real camera of a rig file. No picture of the drivers' own emulations is used.

KOALA_CAMERA_RIG=my_rig.yaml .venv/bin/python -m pytest tests/hardware/test_cameras.py -m hardware

`KOALA_CAMERA_SET` holds settings of its trajectory, as `--set` takes them: 'camera.width=640 camera.height=480'.
"""

import os

import pytest

from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.rig.cameras import camera_for
from koala3d.capture.rig.contract import CONTRACT, Subject
from koala3d.capture.rig.naming import describe, is_simulated

pytestmark = pytest.mark.hardware


@pytest.fixture(scope="module")
def subject():
    rig = os.environ.get("KOALA_CAMERA_RIG")
    if not rig:
        pytest.skip("no camera: KOALA_CAMERA_RIG, a rig file, is not set")
    description = describe(rig)
    assert not is_simulated(rig, description), "give a rig that is not simulated"
    session = load_trajectory("koala_demo", overrides=["camera.binning=1", *os.environ.get("KOALA_CAMERA_SET", "").split()])
    other = None if "exposure_us" in description.camera.leave else session.camera.exposure_us / 2

    def make(settings):
        return camera_for(rig, session.model_copy(update={"camera": settings}), scene="")

    return Subject(make, session.camera, other_exposure_us=other)


@pytest.mark.parametrize("clause", CONTRACT)
def test_it_keeps_the_contract(subject, clause):
    CONTRACT[clause](subject)


def test_longer_exposures_are_brighter(subject):
    if subject.other_exposure_us is None:
        pytest.skip("the camera takes no exposure time")
    with subject.make(subject.settings) as camera:
        long = camera.grab().pixels.mean()
        camera.set_exposure(subject.other_exposure_us)
        assert camera.grab().pixels.mean() < long  # take the cap off
