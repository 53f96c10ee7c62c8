"""Neither folders nor modules of the package form a circle: a driver does not import the rig that opens it."""

import ast
from collections.abc import Callable
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "capture"


def module(name: str) -> str:
    """The module, or the package, to which a full name belongs."""
    parts = name.split(".")[2:]
    while parts and not (PACKAGE.joinpath(*parts).is_dir() or PACKAGE.joinpath(*parts).with_suffix(".py").is_file()):
        parts = parts[:-1]  # a name inside a module
    return "/".join(parts)


def folder(name: str) -> str:
    """Folder of the module to which a full name belongs; the module itself if it is directly in the package."""
    found = module(name)
    return found if "/" not in found or PACKAGE.joinpath(found).is_dir() else found.rpartition("/")[0]


def imports(place: Callable[[str], str]) -> dict[str, set[str]]:
    """Which places each place imports, also inside functions and for type checkers."""
    found: dict[str, set[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        here = place(".".join(("koala3d", "capture", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__"))
        names: set[str] = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                names |= {f"{node.module}.{alias.name}" for alias in node.names}
            elif isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
        found.setdefault(here, set()).update({place(name) for name in names if name.startswith("koala3d.capture.")} - {here})
    return found


def circles(found: dict[str, set[str]]) -> list[str]:
    """The places that import themselves through others."""
    round_trips = []
    for start in found:
        reached, waiting = set(), set(found[start])
        while waiting:
            one = waiting.pop()
            reached.add(one)
            waiting |= found.get(one, set()) - reached
        if start in reached:
            round_trips.append(start)
    return round_trips


def test_the_walk_sees_what_it_should() -> None:
    found = imports(folder)
    assert {"rig", "drivers/cameras", "drivers/ur", "sim", "sim/laboratory", "planning", "cli", "model"} <= set(found)
    assert {"drivers/cameras", "drivers/ur", "sim", "model"} <= found["rig"] and "rig" in found["recording"]
    assert "model/arm" in imports(module)["model/carrier"]


def test_no_folder_imports_itself_through_another() -> None:
    assert not circles(imports(folder))


def test_no_module_imports_itself_through_another() -> None:
    assert not circles(imports(module))
