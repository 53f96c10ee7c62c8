"""What `--help` of a command looks like: as wide as the terminal, commands and options in panels, no sentence cut off."""

from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

MAIN, LOOK, CHECK, STUDY = "Main way", "Look", "Check", "Study"
"""Panels of commands, in this order."""
PANELS = (MAIN, LOOK, CHECK, STUDY)
WIDE = 10_000
"""More columns than any terminal has, and more characters than any sentence."""


def _write(formatter: Any, title: str, rows: list[tuple[str, str]]) -> None:
    if rows:
        with formatter.section(title):
            formatter.write_dl(rows)


class Group(TyperGroup):
    """A command with subcommands, each in its panel with the whole first sentence of its help."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the panels; a command without one goes under "Commands"."""
        rows: dict[str, list[tuple[str, str]]] = {panel: [] for panel in PANELS}
        for name, command in self.commands.items():
            if not command.hidden:
                panel = getattr(command, "rich_help_panel", None)
                title = panel if isinstance(panel, str) else "Commands"
                rows.setdefault(title, []).append((name, command.get_short_help_str(WIDE)))
        for title, commands in rows.items():
            _write(formatter, title, commands)


class Command(TyperCommand):
    """A command whose options may be in panels (`typer.Option(..., rich_help_panel=...)`)."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments, options without a panel, then each panel."""
        rows: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for parameter in self.get_params(ctx):
            if (record := parameter.get_help_record(ctx)) is None:
                continue
            panel = getattr(parameter, "rich_help_panel", None)
            plain = "Arguments" if parameter.param_type_name == "argument" else "Options"
            rows.setdefault(panel if isinstance(panel, str) else plain, []).append(record)
        for title, records in rows.items():
            _write(formatter, title, records)


class App(typer.Typer):
    """`typer.Typer` whose commands have this help."""

    def command(self, name: str | None = None, *, panel: str | None = None, **options: Any) -> Any:
        """Decorator of a command; `panel` is one of `PANELS`."""
        return super().command(name, cls=Command, rich_help_panel=panel, **options)
