"""Rig files."""

import numpy as np
import pytest

from capture.rig.description import RigDescription, load_rig
from capture.rig.opening import describe
from datasets.core.errors import UsageError


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
