"""A hook of mkdocs: adds the lab notes, and pages that mkdocs.yml does not name, to the menu."""

from pathlib import Path
from typing import Any


def on_config(config: Any) -> Any:
    """Append the lab notes, newest first, and every page that the menu lacks."""
    menu, docs = str(config.nav), Path(config.docs_dir)
    notes = sorted((f"lab/{path.name}" for path in (docs / "lab").glob("2*.md")), reverse=True)
    config.nav.append({"Lab notes": ["lab/index.md", *notes]})
    if missing := sorted(path.name for path in docs.glob("*.md") if f"'{path.name}'" not in menu):
        config.nav.append({"More": missing})
    return config
