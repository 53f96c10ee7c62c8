from pathlib import Path

import pytest

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.output.evaluate import METRICS
from koala3d.reconstruct.run import Run
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.studies import skips
from koala3d.reconstruct.studies.jobs import BASE, CELLS, Job
from koala3d.reconstruct.training.decisions import record
from koala3d.reconstruct.training.decisions.skip import Skip


def cell(
    folder: Path, name: str, override: list[str], psnr: float, degrees: float | None, ms: float, left_out: list[Skip]
) -> None:
    """A measured run of a hundred steps, all but the last tenth of them disturbed."""
    path = folder / CELLS / name
    run = Run.create(
        path, load_config(overrides=override), folder, SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.1, 2.0)), {}
    )
    seconds = 0.0
    for step in range(10, 101, 10):
        seconds += 10 * ms / 1e3 * (1 if step > 80 else 3)
        run.append_log({"step": step, "seconds": seconds})
    files.write_json(path / METRICS, {"mean": {"psnr": psnr} | ({} if degrees is None else {skips.NORMALS: degrees})})
    record.write(path, left_out)


def skip(name: str, skipped: bool) -> Skip:
    return Skip.of(name, skipped, "seen", "time")


def test_cost_is_what_skipping_loses_whichever_is_the_default(tmp_path: Path) -> None:
    """Base skips empty rays and keeps samples; the cells invert both."""
    both = [skip("empty_rays", True), skip("multisampling", False)]
    cell(tmp_path, BASE, [], 30.0, 12.0, 10.0, both)
    cell(tmp_path, "empty_rays", ["skip.empty_rays=false"], 30.05, 12.1, 25.0, [skip("empty_rays", False)])
    cell(tmp_path, "multisampling", ["skip.multisampling=true"], 29.7, 12.0, 8.0, [skip("multisampling", True)])
    empty, fine = skips.compare(tmp_path, "empty_rays"), skips.compare(tmp_path, "multisampling")
    assert empty.cost_db == pytest.approx(0.05) and empty.cost_deg == pytest.approx(-0.1) and empty.cheap and empty.applied
    assert empty.step_ms == pytest.approx((25.0, 10.0)), "the undisturbed tenth"
    assert fine.cost_db == pytest.approx(0.3) and not fine.cheap and fine.step_ms == pytest.approx((10.0, 8.0))
    text = skips.markdown([empty, fine])
    assert "+0.05 dB | -0.10° | 25.0 → 10.0 ms | yes" in text and "+0.30 dB" in text and "| no |" in text
    skips.write([empty, fine], tmp_path)
    row = (tmp_path / "skips.csv").read_text().splitlines()[1]
    assert row == f"{tmp_path.name},empty_rays,True,0.05,-0.1,25.0,10.0,True"


def test_scenes_without_normals_and_skips_that_do_not_apply_are_marked(tmp_path: Path) -> None:
    cell(tmp_path, BASE, [], 30.0, None, 10.0, [skip("surroundings", False)])
    cell(tmp_path, "surroundings", ["skip.surroundings=false"], 30.0, None, 10.0, [skip("surroundings", False)])
    result = skips.compare(tmp_path, "surroundings")
    assert result.cost_deg is None and result.cheap and not result.applied
    assert "| - | 10.0 → 10.0 ms | does not apply |" in skips.markdown([result])


def test_every_skip_has_a_cell_that_inverts_it() -> None:
    wanted = skips.cells(())
    assert list(wanted) == [BASE, *record.NAMES]
    for name in record.NAMES:
        assert getattr(load_config(overrides=list(wanted[name])).skip, name) != getattr(load_config().skip, name)
    with pytest.raises(UsageError, match="multisampling"):
        skips.cells(["multisample"])


def test_a_comparison_is_resumed_with_the_same_settings_only(
    ball_scene: tuple[Scene, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stub(job: Job) -> None:
        if not job.path.exists():
            cell(job.path.parents[1], job.path.name, list(job.changes), 30.0, None, 10.0, [])

    monkeypatch.setattr(Job, "run", stub)
    out = tmp_path / "skips"
    ask = lambda **request: skips.run([str(ball_scene[1])], out, names=["multisampling"], **request)  # noqa: E731
    with pytest.raises(UsageError, match="surfnerf"):
        ask(model="surfnrf")
    assert not out.exists()
    assert ask() == ask() and (out / "skips.md").is_file()
    with pytest.raises(UsageError, match=r"started with other settings.*overrides was nothing"):
        ask(overrides=["scale=0.5"])
