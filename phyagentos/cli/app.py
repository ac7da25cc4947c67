"""`paos`: the commands, assembled. One table names them all; `main` maps outcomes to exit codes.

Commands import their planes when they run, so that `paos --help` loads no solver and `paos agent` no simulator.
"""

import os
import signal
import sys
from collections.abc import Callable

import typer

from phyagentos.cli import (
    authoring,
    doctor,
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


COMMANDS: dict[str, Callable[..., object]] = {
    "run": running.run,
    "agent": running.agent,
    "watch": running.watch,
    "preflight": preflight.preflight,
    "lint": authoring.lint,
    "compile": authoring.compile_graph,
    "init": scaffolding.init,
    "list": showing.list_names,
    "schema": showing.show_schema,
    "lifecycle": showing.show_lifecycle,
    "why": explaining.why,
    "graph": explaining.show_graph,
    "rerun": explaining.rerun,
    "cancel": stopping.cancel,
    "pause": stopping.pause,
    "resume": stopping.resume,
    "estop": stopping.estop,
    "edit": editing.edit,
    "judge": editing.judge,
    "doctor": doctor.examine_machine,
    "codes": error_codes.show_codes,
    "verify": verification.verify,
}
GROUPS: dict[str, tuple[str, tuple[tuple[str, Callable[..., object]], ...]]] = {
    "tree": ("Behaviour trees.", (("show", showing.show_tree),)),
    "evidence": ("Evidence bundles.", (("verify", evidence.verify), ("prune", evidence.prune))),
    "store": (
        "The journal of a workspace.",
        (("check", store.check), ("repair", store.repair), ("compact", store.compact), ("stats", store.stats)),
    ),
    "memory": ("What verdicts taught.", (("show", memory.show), ("why", memory.why), ("forget", memory.forget))),
}

for name, command in COMMANDS.items():
    app.command(name)(command)
for name, (help_text, commands) in GROUPS.items():
    group = typer.Typer(help=help_text, no_args_is_help=True, rich_markup_mode=None)
    for each, command in commands:
        group.command(each)(command)
    app.add_typer(group, name=name)


def main() -> None:
    """Entry point of the console script `paos`."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as Ctrl-C does: temporary folders are removed
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
