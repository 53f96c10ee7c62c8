"""That `make package` notices what is missing from a package and what should not be in it."""

import importlib.util
import io
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def package():
    spec = importlib.util.spec_from_file_location("package_check", Path(__file__).with_name("package.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def wheel(path: Path, names: set[str]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name in (*(f"koala3d/{name}" for name in names), "koala_capture-0.1.0.dist-info/METADATA"):
            archive.writestr(name, "")
    return path


def source(path: Path, names: set[str]) -> Path:
    with tarfile.open(path, "w:gz") as archive:
        for name in (*names, "pyproject.toml", "koala_capture.egg-info/SOURCES.txt"):
            archive.addfile(tarfile.TarInfo(f"koala_capture-0.1.0/{name}"), io.BytesIO())
    return path


def test_the_checkout_has_settings_pages_and_no_tests(package) -> None:
    found = package.wanted(ROOT)
    assert {"configs/arms/panda.urdf", "capture/planning/plan.html", "configs/models/surfnerf.yaml", "calib/cli.py"} <= found
    assert not [name for name in found if name.startswith(("tests", "docs")) or name.endswith(".png")]


@pytest.mark.parametrize(("pack", "read"), [(wheel, "in_wheel"), (source, "in_source")])
def test_what_a_package_lacks_or_has_too_much_is_named(package, tmp_path: Path, pack, read: str) -> None:
    expected = package.wanted(ROOT)
    package.compare(getattr(package, read)(pack(tmp_path / "whole", expected)), expected, "package")
    with pytest.raises(package.PackageFailed, match=r"lacks 1 files: configs/arms/panda\.urdf"):
        found = getattr(package, read)(pack(tmp_path / "less", expected - {"configs/arms/panda.urdf"}))
        package.compare(found, expected, "package")
    with pytest.raises(package.PackageFailed, match=r"should not hold 1 files: tests/test_help\.py"):
        found = getattr(package, read)(pack(tmp_path / "more", expected | {"tests/test_help.py"}))
        package.compare(found, expected, "package")


def test_the_citation_is_of_this_version(package, tmp_path: Path) -> None:
    assert package.cited_version(ROOT) in (ROOT / "CITATION.cff").read_text()
    (tmp_path / "pyproject.toml").write_text('[project]\nversion = "7.0.0"\n')
    (tmp_path / "CITATION.cff").write_text("version: 0.1.0\n")
    with pytest.raises(package.PackageFailed, match=r"of version 0\.1\.0, pyproject\.toml of 7\.0\.0"):
        package.cited_version(tmp_path)
