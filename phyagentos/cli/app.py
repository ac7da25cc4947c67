"""`paos`: the commands, assembled. Every group registers itself on one typer app; `main` maps outcomes to exit codes.

Commands import their planes when they run, so that `paos --help` loads no solver and `paos agent` no simulator.
"""

import os
import sys

import typer

from phyagentos.cli import (
    authoring,
    editing,
    error_codes,
    evidence,
    explaining,
    memory,
    preflight,
    running,
    scaffolding,
    showing,
    stopping,
    store,
    verification,
)
from phyagentos.cli.doctor import command as doctor
from phyagentos.cli.outcome import ExitCode, is_debugging, report_exception

app = typer.Typer(
    name="paos",
    help="Robots run on sessions that are verified, not merely finished.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"phyagentos {version('phyagentos')}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(False, "--version", callback=_print_version, is_eager=True, help="Print the version."),
    debug: bool = typer.Option(False, "--debug", help="Show tracebacks."),
) -> None:
    del version
    if debug:
        os.environ["PAOS_DEBUG"] = "1"  # both planes inherit it


for group in (
    running,
    preflight,
    authoring,
    scaffolding,
    showing,
    explaining,
    stopping,
    editing,
    evidence,
    doctor,
    error_codes,
    store,
    verification,
    memory,
):
    group.register(app)


def main() -> None:
    """Entry point of the console script `paos`."""
    try:
        outcome = app(standalone_mode=False)
        code = outcome if isinstance(outcome, int) else ExitCode.GOAL_MET
    except BaseException as error:
        code = _to_exit_code(error)
    sys.exit(int(code))


def _to_exit_code(error: BaseException) -> int:
    show = getattr(error, "show", None)  # a usage error knows how to print itself
    if callable(show):
        show()
        return int(ExitCode.INVALID_INPUT)
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else int(ExitCode.INTERNAL_ERROR)
    if isinstance(error, typer.Abort):
        return int(ExitCode.INTERRUPTED)
    return int(report_exception(error, debug=is_debugging(sys.argv)))
