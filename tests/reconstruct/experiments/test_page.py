"""The page says what was measured, what failed, and where."""

from collections.abc import Callable
from pathlib import Path

from koala3d.datasets.core import files
from koala3d.reconstruct.bench import report
from koala3d.reconstruct.bench.records import Records
from koala3d.reconstruct.bench.runner import PROFILES, PROFILES_FORMAT, PROFILES_VERSION, RECORDS


def test_everything_is_on_the_page(tmp_path: Path, make_row: Callable) -> None:
    records = Records(tmp_path / RECORDS)
    cost = make_row(kind="cost", width=200, height=200, train_views=50, seconds=0.4, preparation_s=2.0)
    lego = make_row(scene="lego400", scale=0.5, budget_s=60.0, psnr=29.5)
    failed = make_row(seed=2, status="failed: no <memory>", psnr=None)
    for row in (make_row(), make_row(seed=1, psnr=27.0), cost, lego, failed):
        records.append(row)
    profile = {
        "step_ms": 40.0,
        "second_pass_step_ms": 60.0,
        "rays": 4096,
        "samples": 16384,
        "parts": [["samples on rays", "encoding", "forward", 9.87]],
    }
    files.write_json(tmp_path / PROFILES, {"format": PROFILES_FORMAT, "version": PROFILES_VERSION, "profiles": {"one": profile}})
    peer = {
        "program": "the published one",
        "scene": "lego400",
        "scale": 0.5,
        "seconds": 30.0,
        "psnr": 9.96,
        "rays_per_s": 125.0,
        "view_s": None,
        "note": "",
    }
    written = report.write(tmp_path, [peer])
    text = written.read_text(encoding="utf-8")
    for words in ("26.0 ± 1.4", "the published one", "400", "9.87", "no &lt;memory&gt;", "a processor", "40.0 ms per step"):
        assert words in text, words
    assert text.count("<svg") == 3  # two scenes, one profile
    assert report.write(tmp_path).read_text(encoding="utf-8") != text  # written again, without the other program


def test_an_empty_benchmark_has_a_page(tmp_path: Path) -> None:
    assert "Run time against error" in report.write(tmp_path).read_text(encoding="utf-8")
