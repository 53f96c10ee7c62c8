"""The folders of the package form no circle: a driver does not import the rig that opens it."""

import ast
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "capture"


def place(name: str) -> str:
    """Folder of a module, or the module itself where it is directly in the package."""
    parts = name.split(".")[2:]
    while parts and not (PACKAGE.joinpath(*parts).is_dir() or PACKAGE.joinpath(*parts).with_suffix(".py").is_file()):
        parts = parts[:-1]  # a name inside a module
    inside_folder = len(parts) > 1 and not PACKAGE.joinpath(*parts).is_dir()
    return "/".join(parts[:-1] if inside_folder else parts)


def imports() -> dict[str, set[str]]:
    """Which places each place imports, also inside functions."""
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


def test_the_walk_sees_what_it_should() -> None:
    found = imports()
    assert {"rig", "drivers/cameras", "drivers/ur", "sim", "sim/laboratory", "planning", "cli", "model"} <= set(found)
    assert {"drivers/cameras", "drivers/ur", "sim", "model"} <= found["rig"] and "rig" in found["recording"]


def test_no_folder_imports_itself_through_another() -> None:
    found = imports()
    circles = []
    for start in found:
        reached, waiting = set(), set(found[start])
        while waiting:
            one = waiting.pop()
            reached.add(one)
            waiting |= found.get(one, set()) - reached
        if start in reached:
            circles.append(start)
    assert not circles
