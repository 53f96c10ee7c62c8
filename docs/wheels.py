"""Ask the package index which of our dependencies have wheels, and write the table of `docs/install.md`.

    python docs/wheels.py            # a minute; needs the network
    python docs/wheels.py --print    # show the table, change nothing

A dependency counts for a Python version and a system where pip finds a wheel there that satisfies the range of `pyproject.toml`.
"""

import argparse
import datetime
import re
import subprocess
import sys
import tempfile
import tomllib
from concurrent.futures import ThreadPoolExecutor
from itertools import groupby
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "install.md"
BEGIN, END = "<!-- wheels: written by docs/wheels.py -->", "<!-- end of wheels -->"
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
SYSTEMS = {
    "Linux x86-64": [f"manylinux_2_{minor}_x86_64" for minor in range(35, 4, -1)] + ["manylinux2014_x86_64", "manylinux1_x86_64"],
    "Linux ARM": [f"manylinux_2_{minor}_aarch64" for minor in range(35, 16, -1)] + ["manylinux2014_aarch64"],
    "macOS ARM": [f"macosx_{major}_0_{kind}" for major in range(15, 10, -1) for kind in ("arm64", "universal2")],
}
"""Wheel tags of each system, newest first: glibc 2.35 (Ubuntu 22.04), macOS 15."""
NOT_SHIPPED = ("test", "docs", "lock")
"""Extras for the people who work on the project; the table leaves them out."""


def requirements() -> dict[str, str]:
    """Name to requirement (range, without extras and markers) of every dependency in pyproject.toml."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lists = [project["dependencies"], *(v for k, v in project["optional-dependencies"].items() if k not in NOT_SHIPPED)]
    found: dict[str, str] = {}
    for line in (line for entries in lists for line in entries):
        match = re.match(r"([A-Za-z0-9._-]+)(\[[^]]*\])?\s*([^;]*)", line)
        assert match is not None, line
        if match[1] != project["name"]:
            found.setdefault(match[1], (match[1] + match[3]).strip())
    return found


def wheels_of(requirements: dict[str, str], python: str, platforms: list[str]) -> set[str]:
    """Names of the requirements for which pip finds a wheel, for one Python version and one system."""
    names = dict(requirements)
    while True:  # pip names one missing package at a time
        missing = _first_missing(list(names.values()), python, platforms)
        if missing is None:
            return set(names)
        names = {name: line for name, line in names.items() if name.lower() != missing.lower()}


def _first_missing(lines: list[str], python: str, platforms: list[str]) -> str | None:
    tag = "cp" + python.replace(".", "")
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pip", "install", "--dry-run", "--no-deps", "--quiet", "--only-binary=:all:"]
        command += ["--target", folder, "--python-version", python, "--implementation", "cp"]
        command += [word for abi in (tag, "abi3", "none") for word in ("--abi", abi)]
        command += [word for platform in platforms for word in ("--platform", platform)]
        done = subprocess.run([*command, *lines], capture_output=True, text=True)
    if done.returncode == 0:
        return None
    match = re.search(r"No matching distribution found for ([A-Za-z0-9._-]+)", done.stderr)
    if match is None:
        raise SystemExit(f"error: pip failed for Python {python}: {done.stderr.strip().splitlines()[-1]}")
    return match[1]


def versions(found: list[str]) -> str:
    """Python versions as a reader scans them: '3.11 to 3.14', '3.11, 3.13', or a dash for none."""
    indexed = [(PYTHONS.index(python), python) for python in found]
    runs = [[python for _, python in run] for _, run in groupby(indexed, lambda pair: pair[0] - indexed.index(pair))]
    return ", ".join(run[0] if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs) or "–"


def table() -> str:
    """The table in Markdown, with the date of the answer."""
    wanted = requirements()
    asked = [(system, python) for system in SYSTEMS for python in PYTHONS]
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(lambda ask: wheels_of(wanted, ask[1], SYSTEMS[ask[0]]), asked))
    there = {(name, *ask) for ask, names in zip(asked, answers, strict=True) for name in names}
    cells = {
        name: [versions([python for python in PYTHONS if (name, system, python) in there]) for system in SYSTEMS]
        for name in wanted
    }
    everywhere = [versions(list(PYTHONS))] * len(SYSTEMS)
    rows = [f"| `{name}` | " + " | ".join(row) + " |" for name, row in cells.items() if row != everywhere]
    rest = ", ".join(f"`{name}`" for name, row in cells.items() if row == everywhere)
    head = ["| package | " + " | ".join(SYSTEMS) + " |", "|---|" + "---|" * len(SYSTEMS)]
    last = f"| all others | {' | '.join(everywhere)} |"
    today = datetime.date.today().isoformat()
    return "\n".join(
        [f"Wheels for Python {versions(list(PYTHONS))} on {today}:", "", *head, *rows, last, "", f"All others: {rest}."]
    )


def main() -> None:
    """Write the table between its marks, or print it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--print", action="store_true", dest="show", help="Show the table and change nothing.")
    options = parser.parse_args()
    made = table()
    if options.show:
        sys.stdout.write(made + "\n")
        return
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    _, mark, after = rest.partition(END)
    if not mark:
        raise SystemExit(f"error: {PAGE} has no table to replace: {BEGIN} ... {END}")
    PAGE.write_text(f"{before}{BEGIN}\n{made}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
