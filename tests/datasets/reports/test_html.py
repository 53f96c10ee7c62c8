"""The page of all reports: self-contained, escaped, sortable, and with both pictures of a pair on paper."""

import base64
import re
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.reports.drawing import blank, svg_of
from koala3d.datasets.reports.html import Number, ReportPage
from tests.browser import Browse


@pytest.mark.parametrize(("number", "text"), [
    (Number(2.2218, "mm", 0.0169), "2.222 ± 0.017"), (Number(-61.9556, "mm", 2.4), "-62.0 ± 2.4"),
    (Number(634.776, "px", 36.0), "635 ± 36"),
    (Number(26.98859, "dB"), "26.99"), (Number(0.77170), "0.7717"), (Number(10763, digits=0), "10763"), (Number(0.0), "0.000"),
    (Number(None, "mm"), "–"), (Number(float("nan")), "–"), (Number(float("inf")), "–"), (Number(3.14159, digits=1), "3.1"),
    (Number(1.0, "", 0.0), "1.000"),
])  # fmt: skip
def test_digits_of_numbers_follow_their_deviation(number: Number, text: str) -> None:
    """Two significant digits of the deviation, where there is one; four of the value otherwise."""
    assert number.text == text


def filled() -> ReportPage:
    page = ReportPage("<Lens> & arm", made_by=["calib report 'a b' --out c.html"])
    page.headline([("test <PSNR>", Number(26.99, "dB"))], "on 10 & more views")
    page.section("Findings", "what is <wrong>")
    page.items(["error: <b>", "warning: x", "no level: here"])
    page.numbers([("fx", Number(634.8, "px", 0.04), "focal length")])
    page.table(
        ("view", "PSNR", "count"), [("b", Number(9.5, "dB"), 2), ("a", Number(27.25, "dB"), 10), ("c", Number(None, "dB"), 1)]
    )
    first, second = np.zeros((40, 60, 3), np.float32), np.ones((40, 60, 1), np.float32)
    page.wipes([("colour", first, second), ("depth", None, second)])
    page.picture(np.full((20, 30, 3), 128, np.uint8), "grey", "a picture")
    drawing = blank(3, 2)
    drawing.add_subplot().plot([0, 1], [1, 2])
    page.drawing(svg_of(drawing), "a curve")
    return page


def test_the_page_needs_nothing_else_and_everything_is_escaped() -> None:
    text = filled().render()
    HTMLParser().feed(text)
    without_svg = re.sub(r"<svg.*?</svg>", "", text, flags=re.S)  # names of XML are addresses that nobody fetches
    assert not re.search(r"https?://|@import|src=\"(?!data:)|url\((?!#)", without_svg)
    assert "<Lens>" not in text and "&lt;Lens&gt; &amp; arm" in text and "<b>" not in text.split("<ul>")[1].split("</ul>")[0]
    assert '<span class="error">error</span>: &lt;b&gt;' in text and "<li>no level: here</li>" in text
    assert "calib report &#39;a b&#39; --out c.html" in text and 'href="#made-by"' in text
    assert "prefers-color-scheme: dark" in text and "@media print" in text and "$" not in text


def test_pictures_are_what_was_given() -> None:
    found = [base64.b64decode(data) for data in re.findall(r'src="data:image/png;base64,([^"]+)"', filled().render())]
    pixels = [np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)) for data in found]
    assert [(p.shape, int(p.min()), int(p.max())) for p in pixels] == [
        ((40, 60, 3), 0, 0),
        ((40, 60, 3), 255, 255),
        ((40, 60, 3), 255, 255),
        ((20, 30, 3), 128, 128),
    ]


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    filled().write(tmp_path / "page.html")
    with pytest.raises(UsageError, match="already exists"):
        filled().write(tmp_path / "page.html")


def test_headings_stand_over_numbers_at_the_right() -> None:
    page = ReportPage("t")
    page.table(("name", "PSNR", "of"), iter([("a", Number(1.0), 2), ("b", Number(None), "none")]))
    page.table(("name", "PSNR"), [])
    text = page.render()
    assert "<th>name</th><th class=number>PSNR</th><th>of</th>" in text and "<th>name</th><th>PSNR</th>" in text


@pytest.mark.timeout(600)
def test_a_browser_sorts_wipes_and_prints(tmp_path: Path, browse: Browse) -> None:
    filled().write(tmp_path / "page.html")
    with browse((tmp_path / "page.html").as_uri()) as window:
        page = window.page

        def column() -> list[str]:
            return page.eval_on_selector_all("table.sortable tbody tr td:first-child", "all => all.map(e => e.textContent)")

        head = lambda name: page.locator("table.sortable th", has_text=name).click()  # noqa: E731
        assert column() == ["b", "a", "c"]
        head("PSNR")
        assert column() == ["b", "a", "c"], "9.5 before 27.25, as numbers; what is not known comes last"
        head("PSNR")
        assert column() == ["a", "b", "c"], "and the other way, what is not known still last"
        head("count")
        assert column() == ["c", "b", "a"]
        wipe = page.locator(".wipe")
        wipe.scroll_into_view_if_needed()
        box = wipe.bounding_box()
        for share in (0.25, 0.9):
            page.mouse.move(box["x"] + share * box["width"], box["y"] + 5)
            seen = np.asarray(cv2.imdecode(np.frombuffer(wipe.screenshot(), np.uint8), 0)) > 128
            assert abs(seen.mean() - (1 - share)) < 0.05, "the second picture, white, is seen right of the pointer"
        page.emulate_media(media="print")
        places = page.eval_on_selector_all(".wipe img", "all => all.map(e => e.getBoundingClientRect().left)")
        assert places[1] > places[0] + 20, "paper shows both, side by side"
        page.emulate_media(media="screen", color_scheme="dark")
        ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert max(int(value) for value in re.findall(r"\d+", ground)[:3]) < 60
