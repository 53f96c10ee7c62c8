"""The house's plan: who may import whom, and that `datasets` is ours."""

import ast
from pathlib import Path

import pytest

import datasets

ROOT = Path(__file__).parent.parent
PACKAGES = ("capture", "calib", "datasets", "reconstruct")
ALLOWED = {package: {package, "datasets", "configs"} for package in PACKAGES} | {"datasets": {"datasets"}}
VENDORS = {"OpenImageIO": 1, "pypylon": 1, "mitsuba": 1, "rtde_control": 1, "pycolmap": 2}
"""Vendor's library: in how many modules it may be imported."""
NUMERICS = {"jax", "equinox", "optax", "mitsuba", "pypylon", "rtde_control"}


def modules() -> list[Path]:
    return [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def imported(path: Path) -> set[str]:
    """Top-level names of all imports of a file, those inside functions included."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found.add(node.module.split(".")[0])
    return found


def test_the_walk_finds_the_packages() -> None:
    assert {path.relative_to(ROOT).parts[0] for path in modules()} == set(PACKAGES)


def test_datasets_is_ours() -> None:
    """Another package of this name is widely installed; importing that one would be a riddle to the user."""
    assert Path(datasets.__file__).parent == ROOT / "datasets"


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_import_downwards_only(package: str) -> None:
    wrong = {
        f"{path.relative_to(ROOT)} imports {name}"
        for path in sorted((ROOT / package).rglob("*.py"))
        for name in imported(path) & set(PACKAGES) - ALLOWED[package]
    }
    assert not wrong


def test_ground_floor_has_no_numerics_and_no_hardware() -> None:
    assert not {f"{p.name}: {n}" for p in (ROOT / "datasets").rglob("*.py") for n in imported(p) & NUMERICS}


@pytest.mark.parametrize(("library", "limit"), VENDORS.items())
def test_a_vendors_library_has_one_home(library: str, limit: int) -> None:
    homes = [str(path.relative_to(ROOT)) for path in modules() if library in imported(path)]
    assert len(homes) <= limit, homes


def test_no_file_grows_beyond_500_lines() -> None:
    assert not {str(path.relative_to(ROOT)) for path in modules() if len(path.read_text().splitlines()) > 500}


def test_no_print_outside_the_console() -> None:
    """Libraries return or log; only the console module writes to the terminal."""
    wrong = set()
    for path in modules():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print":
                wrong.add(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert not {place for place in wrong if not place.startswith("datasets/core/console.py")}


def test_nothing_is_executed_or_unpickled() -> None:
    forbidden = {"eval", "exec"}
    for path in modules():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call):
                assert not (isinstance(node.func, ast.Name) and node.func.id in forbidden), f"{path}:{node.lineno}"
                for keyword in node.keywords:
                    value = keyword.value.value if isinstance(keyword.value, ast.Constant) else None
                    assert not (keyword.arg in ("shell", "allow_pickle") and value is True), f"{path}:{node.lineno}"
        assert "pickle" not in imported(path)
