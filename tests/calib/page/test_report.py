"""The page and its figures."""

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from koala3d.calib import calibrate
from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import ARM, KOALA, simulate, target_session
from koala3d.calib.intrinsics import crossval
from koala3d.calib.page import report
from koala3d.calib.page.evidence import gather
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.reports.html import Number, ReportPage


def evidence_of(given=None):
    """Of a session in which view 005 is 10 mm off and view 012 shows no target."""
    rng = np.random.default_rng(0)
    simulated = simulate(rng, KOALA, viewpoints(rng, KOALA, 12, ViewRange()), sigma_px=0.1, arm=ARM)
    session = target_session(simulated)
    reported = session.base_from_flange.copy()
    reported[5] = reported[5] @ pose.from_rotation_vector([0, 0, 0], [0.01, 0, 0])
    session = replace(session, base_from_flange=reported, unseen=("<b>012",))
    return gather(calibrate.calibrate_handeye(session, given, ARM), session)


@pytest.fixture(scope="module")
def evidence():
    return evidence_of()


@pytest.fixture(scope="module")
def page(evidence):
    return report.page(evidence, made_by="calib report FILE --out page.html")


@pytest.fixture(scope="module")
def text(page):
    return page.render()


def pictures(text):
    return [Image.open(BytesIO(base64.b64decode(data))) for data in re.findall(r'src="data:image/png;base64,([^"]+)"', text)]


def test_page_needs_nothing_else(text):
    assert not re.search(r"<script[^>]*src|https?://|src=\"(?!data:)", text)
    HTMLParser().feed(text)
    assert len(re.findall(r"<h2[ >]", text)) == text.count("</h2>") == 11
    assert "calib report FILE --out page.html" in text


def test_numbers_have_their_uncertainty(text, evidence):
    calibration = evidence.calibration
    value = calibration.flange_from_camera
    assert Number(1e3 * value.matrix[0, 3], "mm", value.translation_std_mm[0]).text in text
    assert f"± {calibration.camera_std['fx']:.2g}"[:4] in text


def test_figures_show_something(text):
    found = pictures(text)
    assert len(found) == 8  # residuals, views, coverage, rotations, two ellipses, certainty, two halves
    for picture in found:
        values = np.asarray(picture.convert("L"), float)
        assert min(values.shape) > 250 and values.std() > 5, "an empty figure"


def test_words_and_names_are_there_and_escaped(text):
    assert "flange_from_camera" in text and "disagree" in text
    assert "&lt;b&gt;012" in text and "<b>012" not in text
    assert "<td>005</td>" in text


def test_a_given_camera_is_not_cross_validated():
    page = ReportPage("Calibration")
    report._cross_validation(page, evidence_of(Calibration(KOALA.camera, {})))
    assert "The camera was given" in page.render() and pictures(page.render()) == []


def test_a_camera_alone_has_no_figures_of_an_arm(evidence):
    calibration = replace(evidence.calibration, flange_from_camera=None, base_from_board=None)
    text = report.page(gather(calibration, evidence.everything)).render()
    assert "Rotations" not in text and "Uncertainty of" not in text and len(pictures(text)) == 5


def test_the_difference_from_another_camera_is_drawn(evidence):
    camera = evidence.calibration.camera
    found = crossval.compared(camera, replace(camera, fx=camera.fx + 3), "other.json")
    text = report.page(evidence, others={"other": found}).render()
    assert "Difference from other" in text and len(pictures(text)) == 9
    with pytest.raises(UsageError, match="960x540, not 1920x1080"):
        crossval.compared(camera, camera.scaled(960, 540), "small.json")


def test_nothing_is_overwritten(tmp_path, page):
    (tmp_path / "page.html").write_text("mine")
    with pytest.raises(UsageError, match="already exists"):
        page.write(tmp_path / "page.html")
