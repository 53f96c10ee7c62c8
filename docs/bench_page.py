"""A hook of mkdocs: builds bench/index.html, the report of the tracked benchmark, from its CSV and JSON files."""

from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

BENCH = "reconstruct bench --suite full --model surfnerf --preset fast"
COMMANDS = (
    "reconstruct bench --suite quick --peer docs/bench/peers.csv --data ../shared/data --out DIR",
    f"{BENCH} --scene lego400 --scale 0.5 --budget 60 --budget 120 --seed 0 --data ../shared/data --out DIR",
    f"{BENCH} --scene lego400 --scale 1 --budget 300 --seed 0 --data ../shared/data --out DIR",
    f"{BENCH} --scene SCENE --budget 120 --seed 0 --out DIR",
)


def on_files(files: Any, config: Any) -> Any:
    """Add the page."""
    from koala3d.reconstruct.bench import peers, report

    folder = Path(config.docs_dir) / "bench"
    page = report.render(folder, peers.read(folder / "peers.csv"), made_by=COMMANDS)
    files.append(File.generated(config, "bench/index.html", content=page))
    return files
