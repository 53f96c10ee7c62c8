"""Command-line options that several commands share: one name, one meaning, one help text."""

from pathlib import Path
from typing import Annotated

import typer

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
Rerun = Annotated[
    Path | None, typer.Option("--rerun", metavar="FILE.rrd", help="Also write what happened, for Rerun's viewer; must be new.")
]
Port = Annotated[int, typer.Option(min=0, max=65535, help="Port of 127.0.0.1 for the page; the next free one if it is taken.")]
Scene = Annotated[str, typer.Argument(metavar="SCENE", help="Folder, or a name such as koala/gold_head.")]
DataRoot = Annotated[Path | None, typer.Option(help="Folder in which scene names are looked up, before $KOALA_DATA.")]
OutFolder = Annotated[Path, typer.Option("--out", metavar="FOLDER", help="Folder to write; must be new.")]
OutPage = Annotated[Path, typer.Option("--out", metavar="PAGE.html", help="Page to write; must be new.")]
