"""A hook of mkdocs: pages that mkdocs.yml does not name stand at the end of the menu, so that none is forgotten."""

from pathlib import Path
from typing import Any


def on_config(config: Any) -> Any:
    """Add the pages that are in the folder and not in the menu."""
    menu = str(config.nav)
    unnamed = sorted(path.name for path in Path(config.docs_dir).glob("*.md") if f"'{path.name}'" not in menu)
    if unnamed:
        config.nav.append({"More": unnamed})
    return config
