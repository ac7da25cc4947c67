"""`paos`: the commands, assembled. One table names them all; `main` maps outcomes to exit codes.

Commands import their planes when they run, so that `paos --help` loads no solver and `paos agent` no simulator.
"""

import contextlib
import functools
import inspect
import io
import os
import signal
import sys
from collections.abc import Callable

import typer

from phyagentos.cli import (
    authoring,
    describing,
    doctor,
    editing,
    error_codes,
    evidence,
    explaining,
    memory,
    observing,
    preflight,
    running,
    scaffolding,
    showing,
    stopping,
    store,
    verification,
)
from phyagentos.cli.arguments import AsJson
from phyagentos.cli.outcome import ExitCode, is_debugging, print_json, report_exception

app = typer.Typer(
    name="paos",
    help="Robots run on sessions that are verified, not merely finished.",
    no_args_is_help=True,
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
    "status": observing.status,
    "runs": observing.runs,
    "logs": observing.logs,
    "preflight": preflight.preflight,
    "lint": authoring.lint,
    "compile": authoring.compile_graph,
    "init": scaffolding.init,
    "describe": describing.describe,
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


def with_json(command: Callable[..., object]) -> Callable[..., object]:
    """The command with `--json`: where it has no such option, the lines that it prints become a list."""
    signature = inspect.signature(command)
    if "as_json" in signature.parameters:
        return command

    @functools.wraps(command)
    def call(*, as_json: bool, **arguments: object) -> object:
        if not as_json:
            return command(**arguments)
        with contextlib.redirect_stdout(io.StringIO()) as text:
            code = command(**arguments)
        print_json({"exit_code": code or 0, "result": text.getvalue().splitlines()})
        return code

    own = inspect.Parameter("as_json", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=AsJson)
    call.__dict__["__signature__"] = signature.replace(parameters=[*signature.parameters.values(), own])
    call.__annotations__ = command.__annotations__ | {"as_json": AsJson}
    return call


for name, command in COMMANDS.items():
    app.command(name)(with_json(command))
for name, (help_text, commands) in GROUPS.items():
    group = typer.Typer(help=help_text, no_args_is_help=True, rich_markup_mode=None)
    for each, command in commands:
        group.command(each)(with_json(command))
    app.add_typer(group, name=name)


def main() -> None:
    """Entry point of the console script `paos`."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as Ctrl-C does: temporary folders are removed
    try:
        outcome = app(standalone_mode=False)
        code = outcome if isinstance(outcome, int) else ExitCode.GOAL_MET
    except BaseException as error:
        code = _to_exit_code(error)
        if "--json" in sys.argv and not isinstance(error, SystemExit):
            print_json({"exit_code": code, "error": str(error), "problems": getattr(error, "problems", ())})
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
