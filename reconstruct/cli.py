"""The `reconstruct` command. Commands are defined beside the code that they call and registered here."""

from datasets.core import console
from reconstruct.bench import commands as bench_commands
from reconstruct.options import Preset
from reconstruct.output import commands as output_commands
from reconstruct.studies import commands as study_commands
from reconstruct.training import command as train_command

app = console.make_app("reconstruct", "Train Surf-NeRF on a scene, evaluate it, and export images and geometry.")


def models(preset: Preset = "fast", as_json: console.Json = False) -> None:
    """List the models: encoding, appearance and regularisers under the chosen preset."""
    from reconstruct.listing import models_text
    from reconstruct.models import overview

    rows = overview(preset)
    console.report({"models": rows}, as_json=as_json, text=models_text(rows))


app.command()(train_command.train)
app.command()(models)
app.add_typer(study_commands.app)
app.add_typer(output_commands.app)
app.add_typer(bench_commands.app, name="bench")


def main() -> None:
    """Entry point."""
    console.run(app)


if __name__ == "__main__":
    main()
