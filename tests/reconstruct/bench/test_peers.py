"""Other programs' figures, as a person writes them."""

from pathlib import Path

import pytest

from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.reconstruct.bench import peers


def test_lines_are_read(tmp_path: Path) -> None:
    path = tmp_path / "peers.csv"
    path.write_text("program,scene,scale,seconds,psnr,note\nsurfnerf,lego400,0.5,30,9.96,\nother,teapot,,60,,no test views\n")
    first, second = peers.read(path)
    assert (first["program"], first["scale"], first["seconds"], first["psnr"]) == ("surfnerf", 0.5, 30.0, 9.96)
    assert (
        second["scale"] == 1.0 and second["psnr"] is None and second["rays_per_s"] is None and second["note"] == "no test views"
    )


@pytest.mark.parametrize(("text", "complaint"), [
    ("program,scene,second\n", "did you mean 'seconds'"), ("program,scene\n", "'seconds' is missing"),
    ("program,scene,seconds\na,b,soon\n", "line 2, seconds: is not a number"),
    ("program,scene,seconds\na,,3\n", "line is incomplete"),
])  # fmt: skip
def test_mistakes_are_named(text: str, complaint: str, tmp_path: Path) -> None:
    (tmp_path / "peers.csv").write_text(text)
    with pytest.raises(DatasetError, match=complaint):
        peers.read(tmp_path / "peers.csv")


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such file"):
        peers.read(tmp_path / "peers.csv")
