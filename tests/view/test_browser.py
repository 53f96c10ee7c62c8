"""A window fails its test for whatever is wrong with its page, unless the test expects it."""

from pathlib import Path

import pytest

from tests.browser import Browse

FAULTS = {
    "<script>throw new Error('at once')</script>": "threw at once",
    "<script>setTimeout(() => { throw new Error('later') })</script>": "threw later",
    "<script>Promise.reject(new Error('refused'))</script>": "threw refused",
    "<script>console.error('wrong')</script>": "logged wrong",
    "<img src='http://elsewhere.example/a.png'>": "asked for http://elsewhere.example/a.png",
    "<link rel=stylesheet href='beside.css'>": "asked for file://FOLDER/beside.css",
    "<script>new WebSocket('ws://elsewhere.example/')</script>": "asked for ws://elsewhere.example/",
}
"""Parts of a page, and what is wrong with them."""


def test_whatever_is_wrong_with_a_page_fails_its_test(tmp_path: Path, browse: Browse) -> None:
    (tmp_path / "page.html").write_text("<!doctype html>" + "".join(FAULTS))
    with pytest.raises(AssertionError) as failed, browse((tmp_path / "page.html").as_uri()):
        pass
    found = str(failed.value).replace(str(tmp_path), "FOLDER")
    assert [fault for fault in FAULTS.values() if fault not in found] == []


def test_a_click_that_throws_fails_its_test_and_what_is_expected_does_not(tmp_path: Path, browse: Browse) -> None:
    (tmp_path / "page.html").write_text(
        "<!doctype html><script>console.error('known')</script><button onclick='no()'>press</button>"
    )
    with pytest.raises(AssertionError, match=r"page.html threw no is not defined$"):
        with browse((tmp_path / "page.html").as_uri(), expected="known") as window:
            window.page.get_by_text("press").click()
