"""Small sound captures of other programs, as tests of their readers write them, and ROS bags."""

from functools import partial
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np

from tests import bags
from tests.datasets.formats.captures import test_bop, test_metashape, test_phones, test_reality

SIZE = 18, 24
SECONDS = np.arange(0.0, 1.2, 0.04)
BAGS = tuple(f"bag-{kind}" for kind in bags.KINDS) if find_spec("rosbags") else ()


def _realityscan(folder: Path) -> None:
    rows = [(f"{k}.png", k, 0, 0, 10 * k, 80, 0, 20.0, *[0.01] * 4, 0.0, 0.0, 0, 0) for k in range(3)]
    test_reality.export(folder, [test_reality.row(*row) for row in rows])


def _bag(folder: Path, kind: str) -> None:
    """An arm that never halts, its joint states, a camera that looks at noise, and one more topic that nobody reads."""
    random, path = np.random.default_rng(5), folder / "session.bag" if kind == "ros1" else folder
    if kind != "ros1":
        folder.rmdir()
    with bags.writing(path, kind) as bag:
        for count, t in enumerate(SECONDS):
            stamp, pose = bags.START_NS + round(1e9 * t), np.eye(4)
            pose[:3, 3] = t, 0.2 * t * t, 0.3
            bag.transform("/tf", stamp, "base_link", "tool0", pose)
            bag.joints(stamp, ["a", "b"], [t, -t])
            if count % 6 == 3:
                picture = random.integers(0, 255, (*SIZE, 3), np.uint8)
                if kind == "mcap":
                    data = cv2.imencode(".png", picture)[1].tobytes()
                    bag.compressed("/camera/image_raw/compressed", stamp, data, "bgr8; png compressed bgr8")
                else:
                    bag.picture("/camera/image_raw", stamp, picture, "rgb8")


MAKERS = {
    "metashape": lambda folder: test_metashape.export(folder),
    "realityscan": _realityscan,
    "bop": lambda folder: test_bop.written(folder, objects=2),
    "phone-polycam": partial(test_phones.of_polycam, corrected=False),  # then each file matters
    "phone-record3d": lambda folder: test_phones.of_record3d(folder, 4),
    "phone-scanner": lambda folder: (folder.rmdir(), test_phones.of_scanner(folder, 3)),
    **{name: partial(_bag, kind=name.removeprefix("bag-")) for name in BAGS},
}
"""Writes each kind into an empty folder."""
