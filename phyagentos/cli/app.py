"""`paos`: the commands, assembled. One table names them all; `main` maps outcomes to exit codes.

Commands import their planes when they run, so that `paos --help` loads no solver and `paos agent` no simulator.
"""

import ast
import contextlib
import functools
import inspect
import io
import os
import pkgutil
import signal
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperGroup
from typing_extensions import override

from phyagentos.cli.outcome import ExitCode, print_json, report_exception

PLAIN: dict[str, Any] = {"no_args_is_help": True, "rich_markup_mode": None, "pretty_exceptions_enable": False}
COMMANDS = {  # name -> module and function; the first line of its docstring is the help
    "run": "mission_run:run",
    "ask": "asking:ask",
    "agent": "running:agent",
    "watch": "running:watch",
    "status": "observing:status",
    "runs": "observing:runs",
    "logs": "observing:logs",
    "preflight": "preflight:preflight",
    "lint": "authoring:lint",
    "compile": "authoring:compile_graph",
    "plan": "planning:plan",
    "import": "tree_exchange:import_tree",
    "init": "authoring:init",
    "describe": "describing:describe",
    "list": "showing:list_names",
    "schema": "showing:show_schema",
    "lifecycle": "showing:show_lifecycle",
    "why": "explaining:why",
    "graph": "explaining:show_graph",
    "view": "viewing:view",
    "render": "rendering:render",
    "context": "explaining:show_context",
    "rerun": "explaining:rerun",
    "cancel": "stopping:cancel",
    "pause": "stopping:pause",
    "resume": "stopping:resume",
    "estop": "stopping:estop",
    "edit": "editing:edit",
    "amend": "amending:amend",
    "judge": "editing:judge",
    "doctor": "doctor:examine_machine",
    "codes": "showing:show_codes",
    "approve": "approving:approve",
    "deny": "approving:deny",
    "mcp": "mcp_server:serve",
    "forecasts": "forecasts:show_forecasts",
    "verify": "verification:verify",
}
EXPORTS = ("bt_xml", "html", "lerobot", "mcap", "mermaid", "rrd", "video")
GROUPS = {  # name -> help, module and functions
    "tree": ("Behaviour trees.", "tree_drawing", ("show",)),
    "evidence": ("Evidence bundles.", "evidence", ("verify", "prune")),
    "export": ("Trees, goals and sessions as files for the tools of others.", "exporting", EXPORTS),
    "store": ("The journal of a workspace.", "store", ("check", "repair", "compact")),
    "robot": ("Profiles of robots.", "robots", ("list_", "show", "check", "render", "new")),
    "policy": ("Policies that carry out skills.", "policies", ("serve", "replay")),
    "bench": (
        "Suites of many episodes on the ordinary path.",
        "bench",
        ("run", "resume", "report", "compare", "setup"),
    ),
    "memory": ("What verdicts taught.", "memory", ("show", "why", "forget", "promote", "revoke")),
}


class Commands(TyperGroup):
    """The commands, of which only that which is called is loaded; to list them needs none."""

    @override
    def list_commands(self, ctx: Any) -> list[str]:
        return [*COMMANDS, *GROUPS]

    @override
    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        return load_command(cmd_name) if cmd_name in COMMANDS or cmd_name in GROUPS else None

    @override
    def format_commands(self, ctx: Any, formatter: Any) -> None:
        lines = [(name, read_summary(name)) for name in COMMANDS] + [(name, of[0]) for name, of in GROUPS.items()]
        room = formatter.width - 6 - max(len(name) for name, _ in lines)
        with formatter.section("Commands"):
            formatter.write_dl([(name, textwrap.shorten(line, room, placeholder="...")) for name, line in lines])


def read_summary(name: str) -> str:
    """The first line of a command's docstring, from its source: nothing is imported."""
    module, _, function = COMMANDS[name].partition(":")
    tree = ast.parse(Path(__file__).with_name(f"{module}.py").read_text(encoding="utf-8"))
    found = next(each for each in tree.body if isinstance(each, ast.FunctionDef) and each.name == function)
    return (ast.get_docstring(found) or "").partition("\n")[0]


def load_command(name: str) -> Any:
    """A command, or a group of them, with its module loaded."""
    about, module, functions = GROUPS.get(name, ("", "", ()))
    places = {function.rstrip("_").replace("_", "-"): f"{module}:{function}" for function in functions} or {
        name: COMMANDS[name]
    }
    made = typer.Typer(help=about or None, add_completion=False, **PLAIN)
    for each, place in places.items():
        made.command(each)(with_json(pkgutil.resolve_name(f"phyagentos.cli.{place}")))
    if name in GROUPS:
        made.callback()(lambda: None)
    return typer.main.get_command(made)


app = typer.Typer(
    name="paos",
    help="Robots run on sessions that are verified, not merely finished.",
    cls=Commands,
    **PLAIN,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"phyagentos {version('phyagentos')}")
        raise typer.Exit


@app.callback()
def _root(
    _: bool = typer.Option(False, "--version", callback=_print_version, is_eager=True, help="Print the version."),
    debug: bool = typer.Option(False, "--debug", help="Show tracebacks."),
) -> None:
    if debug:
        os.environ["PAOS_DEBUG"] = "1"  # both planes inherit it


def with_json(command: Callable[..., object]) -> Callable[..., object]:
    """The command with `--json`: where it has no such option, the lines that it prints become a list."""
    from phyagentos.cli.arguments import AsJson

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
        return ExitCode.INVALID_INPUT
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else int(ExitCode.INTERNAL_ERROR)
    if isinstance(error, typer.Abort):
        return ExitCode.INTERRUPTED
    return int(report_exception(error))
