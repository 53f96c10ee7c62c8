"""The rules of the code base: what is installed, who may import whom, how large folders, files and functions may be."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from importlib.metadata import distribution
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("capture", "calib", "datasets", "reconstruct")
OURS = "koala3d."
ALLOWED = {package: {package, "datasets", "configs"} for package in PACKAGES} | {"datasets": {"datasets"}}
VENDORS = {"OpenImageIO": 1, "pypylon": 1, "mitsuba": 2, "rtde_control": 1, "pycolmap": 4}
VENDORS |= {
    "harvesters": 1,
    "genicam": 1,
    "pyrealsense2": 2,
    "gphoto2": 1,
    "ray": 1,
    "rerun": 1,
    "rosbags": 1,
    "nerfbaselines": 1,
}
"""Vendor's library: in how many modules it may be imported. mitsuba: laboratory, path tracing of
assets and scenes. pycolmap: writes files, adjusts bundles, matches features, maps.
pyrealsense2: driver, software device. genicam: settings and errors."""
NUMERICS = {"jax", "equinox", "optax", "mitsuba", "pypylon", "rtde_control", "harvesters", "pyrealsense2", "gphoto2"}


@cache
def modules() -> list[Path]:
    return [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


@cache
def nodes(path: Path) -> list[ast.AST]:
    """Everything in a file, in any order."""
    return list(ast.walk(tree(path)))


@cache
def imported(path: Path) -> set[str]:
    """Our packages and others' that a file imports, those inside functions included."""
    return {name.split(".")[0] for node in nodes(path) for name in imported_names(node)}


def imported_names(node: ast.AST) -> set[str]:
    """Full names that an import statement can refer to, ours without `koala3d.`: for `from a import b`, both "a" and "a.b"."""
    names: set[str] = set()
    if isinstance(node, ast.Import):
        names = {alias.name for alias in node.names}
    elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
        names = {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    assert not names & {*PACKAGES, "configs"}, f"import koala3d.{min(names)}: another package may have the short name"
    return {name.removeprefix(OURS) for name in names} - {OURS.removesuffix(".")}


def running(node: ast.AST, *, functions: bool = True) -> Iterator[ast.AST]:
    """All statements that run: not those for type checkers and, on request, not those inside functions."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and isinstance(child.test, ast.Name) and child.test.id == "TYPE_CHECKING":
            continue
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) and not functions:
            continue
        yield child
        yield from running(child, functions=functions)


def folders() -> list[Path]:
    """All folders with code, packages included."""
    return sorted({path.parent for path in modules()})


def part_of(name: str, package: str) -> str | None:
    """The subfolder or top-level module of a package to which a full name belongs; None for other names."""
    words = name.split(".")
    if words[0] != package or len(words) < 2:
        return None
    place = ROOT / package / words[1]
    return words[1] if place.is_dir() or place.with_suffix(".py").is_file() else None


@cache
def uses(package: str) -> dict[str, set[str]]:
    """For each subfolder and top-level module of a package, the others that it imports."""
    found: dict[str, set[str]] = {}
    for path in sorted((ROOT / package).rglob("*.py")):
        part = path.relative_to(ROOT / package).parts[0].removesuffix(".py")
        names = {name for node in running(tree(path)) for name in imported_names(node)}
        found.setdefault(part, set()).update({other for name in names if (other := part_of(name, package))} - {part})
    return found


def floors(graph: dict[str, set[str]]) -> list[set[str]]:
    """The parts by floor, each importing from lower floors only. What is in a circle, or above one, has no floor."""
    found: list[set[str]] = []
    while ready := {part for part, below in graph.items() if below <= set().union(*found)} - set().union(*found):
        found.append(ready)
    return found


def test_the_walk_finds_the_packages() -> None:
    assert {path.relative_to(ROOT).parts[0] for path in modules()} == set(PACKAGES)


def test_one_name_is_installed() -> None:
    """Packages called `datasets` or `capture` would overwrite others' files: `make install-check` tries it."""
    assert (distribution("koala-capture").read_text("top_level.txt") or "").split() == ["koala3d"]


def test_programs_in_strings_and_pages_import_koala3d() -> None:
    """In the root of the repository the short names are found too, and only there."""
    short = re.compile(rf"(?:from|import) (?:{'|'.join((*PACKAGES, 'configs'))})(?:\.|;| import)|(?<!\.){{package}}\.cli")
    paths = [*modules(), *(ROOT / "tests").rglob("*.py"), *(ROOT / "docs").glob("*.md"), ROOT / "README.md"]
    found = {str(path.relative_to(ROOT)): short.findall(path.read_text()) for path in paths if path != Path(__file__)}
    assert not {path: names for path, names in found.items() if names}


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


@pytest.mark.parametrize("package", PACKAGES)
def test_imports_between_folders_form_no_circle(package: str) -> None:
    graph = uses(package)
    users = {part: {other for other, below in graph.items() if part in below} for part in graph}
    circle = graph.keys() - set().union(*floors(graph)) - set().union(*floors(users))
    assert not {f"{part} imports {other}" for part in circle for other in graph[part] & circle}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_has_at_most_ten_floors(package: str) -> None:
    found = floors(uses(package))
    assert len(found) <= 10, [sorted(floor) for floor in found]


def test_only_pages_need_the_page_library() -> None:
    """A module outside `page` folders imports neither viser nor a page, except inside a function: viser can be left out."""
    wrong = set()
    for path in modules():
        if "page" in path.relative_to(ROOT).parts:
            continue
        for node in running(tree(path), functions=False):
            wrong |= {
                f"{path.relative_to(ROOT)} imports {name}"
                for name in imported_names(node)
                if name.split(".")[0] == "viser" or name.split(".")[1:2] == ["page"]
            }
    assert not wrong


def test_datasets_imports_without_heavy_libraries() -> None:
    """Everything but the pages is imported in a process where viser, pycolmap and matplotlib are missing."""
    paths = [path for path in sorted((ROOT / "datasets").rglob("*.py")) if "page" not in path.parts and path.stem != "drawing"]
    names = [OURS + ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for path in paths]
    code = f"import sys; sys.modules.update(dict.fromkeys(['viser', 'pycolmap', 'matplotlib'])); import {', '.join(names)}"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, timeout=120)


def test_every_folder_says_what_its_files_share() -> None:
    inits = [folder / "__init__.py" for folder in folders()]
    assert not {str(path.relative_to(ROOT)) for path in inits if not path.is_file() or not ast.get_docstring(tree(path))}


def test_at_most_15_modules_are_in_a_folder() -> None:
    counts = {
        str(folder.relative_to(ROOT)): sum(path.name != "__init__.py" for path in folder.glob("*.py")) for folder in folders()
    }
    assert not {folder: count for folder, count in counts.items() if count > 15}


def test_no_file_has_more_than_350_lines() -> None:
    counts = {str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for path in modules()}
    assert not {path: count for path, count in counts.items() if count > 350}


def test_no_function_has_more_than_60_lines() -> None:
    wrong = {}
    for path in modules():
        for node in nodes(path):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and (node.end_lineno or 0) - node.lineno >= 60:
                wrong[f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"] = (node.end_lineno or 0) - node.lineno + 1
    assert not wrong


def test_no_line_has_more_than_130_characters() -> None:
    lines = {
        f"{path.relative_to(ROOT)}:{number}": len(line)
        for path in (*modules(), *sorted((ROOT / "tests").rglob("*.py")))
        for number, line in enumerate(path.read_text().splitlines(), 1)
    }
    assert not {place: length for place, length in lines.items() if length > 130}


def test_at_most_40_tables_are_laid_out_by_hand() -> None:
    places = [
        str(path.relative_to(ROOT)) for path in modules() for line in path.read_text().splitlines() if "# fmt: skip" in line
    ]
    assert len(places) <= 40, sorted(places)


def test_no_print_outside_the_console() -> None:
    """Libraries return or log; only the console module writes to the terminal."""
    wrong = set()
    for path in modules():
        for node in nodes(path):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print":
                wrong.add(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert not {place for place in wrong if not place.startswith("datasets/core/console.py")}


def test_nothing_is_executed_or_unpickled() -> None:
    forbidden = {"eval", "exec"}
    for path in modules():
        for node in nodes(path):
            if isinstance(node, ast.Call):
                assert not (isinstance(node.func, ast.Name) and node.func.id in forbidden), f"{path}:{node.lineno}"
                for keyword in node.keywords:
                    value = keyword.value.value if isinstance(keyword.value, ast.Constant) else None
                    assert not (keyword.arg in ("shell", "allow_pickle") and value is True), f"{path}:{node.lineno}"
        assert "pickle" not in imported(path)
