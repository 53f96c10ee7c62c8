"""What the page of a scene shows, asked of its handles."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import viser

from koala3d.datasets import pose
from koala3d.datasets.formats import koala
from koala3d.datasets.page import open_page, shapes
from koala3d.datasets.reports.page.view import SceneView, caption, views_of
from koala3d.datasets.scene import Scene


def test_findings_are_marked_at_their_views(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    saved = tmp_path / "scene"
    koala.save(make_scene(), saved)
    (saved / "images" / "003.png").write_bytes((saved / "images" / "002.png").read_bytes())
    scene = koala.load(saved)
    with open_page("findings", 0) as page:
        shown = SceneView(page, scene)
        findings = shown.add_findings(saved, matches=False)
        about = next(finding for finding in findings if "same" in finding.what)
        assert [concerned.name for concerned in views_of(about, scene)] == ["003"]
        mark = page.scene.get_handle_by_name(f"/findings/{findings.index(about)}/003/ball")
        assert mark is not None and np.allclose(mark.position, scene.views[3].world_from_camera[:3, 3])
        assert isinstance(mark, viser.IcosphereHandle) and tuple(mark.color) == shapes.COLOURS["warning"]


@pytest.mark.parametrize(("metric", "place"), [(True, "at 1, 2, 0.5 m"), (False, "at 1, 2, 0.5")])
def test_the_caption_of_a_view_has_its_position_and_unit(make_scene: Callable[..., Scene], metric: bool, place: str) -> None:
    view = replace(make_scene().views[0], world_from_camera=pose.rigid(np.eye(3), np.array([1.0, 2.0, 0.5])), truth={})
    assert caption(view, metric=metric).endswith(place)
