"""What every benchmark shares: options by a function's parameters, a table, and one JSON line at the end."""

import functools
import inspect
import json
from collections.abc import Callable, Iterable, Mapping

import typer
from rich.console import Console
from rich.table import Table

from phyagentos.bench.report import Threshold


def run(measure: Callable[..., int]) -> None:
    """Run a benchmark as a program: options by the keywords of `measure`, help by its module, its exit code.

    Args:
        measure: Measures, shows and returns the exit code, as `finish` gives it.
    """
    app = typer.Typer(add_completion=False, rich_markup_mode=None)

    @app.command(help=inspect.getdoc(inspect.getmodule(measure)))
    @functools.wraps(measure)
    def command(**options: object) -> None:
        raise typer.Exit(measure(**options))

    app()


def one_of(*possible: str) -> Callable[[list[str]], list[str]]:
    """A callback of an option that may be repeated: the names must be among these."""

    def check(given: list[str]) -> list[str]:
        if unknown := sorted({*given} - {*possible}):
            raise typer.BadParameter(f"unknown: {', '.join(unknown)}; expected some of {', '.join(possible)}")
        return given

    return check


def show(title: str, columns: Iterable[str], rows: Iterable[Iterable[object]], width: int | None = None) -> None:
    """Print a table; cells as `str` writes them."""
    table = Table(*columns, title=title)
    for row in rows:
        table.add_row(*map(str, row))
    Console(width=width, highlight=False).print(table)


def show_figures(title: str, figures: Mapping[str, float], asked: Mapping[str, Threshold]) -> None:
    """Print every figure beside what is asked of it."""
    rows = ((name, f"{value:.4g}", asked.get(name, "")) for name, value in figures.items())
    show(title, ("figure", "found", "asked"), rows)


def finish(figures: Mapping[str, float], asked: Mapping[str, Threshold]) -> int:
    """Print the closing line, and return the exit code: 0 when every asked figure holds, else 1."""
    holds = all(ask.holds(figures[name]) for name, ask in asked.items())
    rounded = {name: round(value, 6) for name, value in figures.items()}
    print(json.dumps({"figures": rounded, "asked": {name: str(ask) for name, ask in asked.items()}, "holds": holds}))
    return 0 if holds else 1
