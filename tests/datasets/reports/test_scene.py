"""The report of a scene."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.formats import koala
from koala3d.datasets.reports import scene as report
from koala3d.datasets.scene import Scene


@pytest.fixture
def saved(make_scene: Callable[..., Scene], tmp_path: Path) -> Path:
    koala.save(make_scene(), tmp_path / "scene")
    return tmp_path / "scene"


def test_the_report_of_a_sound_scene(saved: Path, tmp_path: Path) -> None:
    steps = []
    findings = report.write(
        saved, tmp_path / "page.html", matches=False, made_by="datasets report scene", done=lambda *n: steps.append(n)
    )
    text = (tmp_path / "page.html").read_text()
    assert findings == [] and "Nothing is wrong" in text and "datasets report scene" in text
    assert text.count("<img") == 9 and text.count('<td class="number" data-value="96">96</td>') == 9
    assert "<b>6</b>" in text and "<b>3</b>" in text and "0.2200" in text, "views by split, and the box's height"
    assert steps and steps[-1][0] == steps[-1][1] and not re.search(r'src="(?!data:)', text)


def test_findings_are_listed_and_damaged_views_left_out(saved: Path, tmp_path: Path) -> None:
    (saved / "images" / "003.png").write_bytes(b"no picture")
    findings = report.write(saved, tmp_path / "page.html", matches=False)
    text = (tmp_path / "page.html").read_text()
    assert any(finding.level == "error" for finding in findings) and '<span class="error">error</span>' in text
    assert text.count("<img") == 8


def test_cameras_are_drawn_where_they_are(saved: Path) -> None:
    scene = koala.load(saved)
    assert report.cameras(scene) == report.cameras(scene), "the same scene gives the same drawing"
    moved = scene.with_views(tuple(scene.views[1:]))
    assert report.cameras(scene) != report.cameras(moved) and np.isfinite(scene.box).all()


def test_nothing_is_overwritten(saved: Path, tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text("mine")
    with pytest.raises(UsageError, match="already exists"):
        report.write(saved, tmp_path / "page.html")
