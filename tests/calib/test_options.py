"""Options that several commands share, as typer sees them."""

from dataclasses import dataclass
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from koala3d.calib import options
from koala3d.datasets.core.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class Size:
    """Two options."""

    width: Annotated[int, typer.Option("--width")]
    height: Annotated[int, typer.Option("--height")] = 3


@pytest.fixture
def app():
    found = typer.Typer()

    @found.command()
    @options.spread
    def area(size: Size, times: Annotated[int, typer.Option("--times")] = 1) -> None:
        """How large it is."""
        typer.echo(size.width * size.height * times)

    return found


def test_a_class_becomes_its_options(app):
    assert CliRunner().invoke(app, ["--width", "2"]).output.strip() == "6"
    assert CliRunner().invoke(app, ["--times", "10", "--height", "5", "--width", "2"]).output.strip() == "100"


def test_an_option_without_a_default_is_demanded_and_the_words_stay(app):
    assert CliRunner().invoke(app, []).exit_code == 2
    shown = CliRunner().invoke(app, ["--help"]).output
    assert "How large it is" in shown and "--width" in shown and "size" not in shown


def test_accuracies_are_converted():
    found = options.Arm(arm_mm=0.1, arm_deg=180.0).accuracy(options.Inexact(joint_deg=90.0, link_mm=2.0))
    assert found.translation_m == pytest.approx(1e-4)
    assert found.rotation_rad == pytest.approx(2 * found.joint_rad) == pytest.approx(3.14159265)


@pytest.mark.parametrize("values", [{"arm_mm": 0.0}, {"arm_deg": -1.0}, {"arm_mm": float("nan")}, {"arm_deg": float("inf")}])
def test_accuracies_that_cannot_be_are_named(values):
    with pytest.raises(UsageError, match="accuracy must be a positive number"):
        options.Arm(**values).accuracy()


def test_a_bound_can_only_be_relaxed():
    assert options.allowed_m(20.0) == pytest.approx(0.02) and options.allowed_m(5.0) == pytest.approx(0.005)
    for wrong in (4.9, -1.0, float("nan"), float("inf")):
        with pytest.raises(UsageError, match="--allow-mm"):
            options.allowed_m(wrong)
