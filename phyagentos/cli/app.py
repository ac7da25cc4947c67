"""`paos`: the commands, assembled. One table names them all; `main` maps outcomes to exit codes.

Commands import their planes when they run, so that `paos --help` loads no solver and `paos agent` no simulator.
"""

import contextlib
import functools
import importlib
import inspect
import io
import os
import signal
import sys
import textwrap
from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperGroup
from typing_extensions import override

from phyagentos.cli.outcome import ExitCode, is_debugging, print_json, report_exception

PLAIN: dict[str, Any] = {"no_args_is_help": True, "rich_markup_mode": None, "pretty_exceptions_enable": False}
COMMANDS: dict[str, tuple[str, str]] = {  # name -> module and function, and the first line of its help
    "run": ("running:run", "Run a goal graph to its verdict: both planes, live progress, a final table."),
    "ask": (
        "asking:ask",
        "Make a goal of a request in words, plan it, show the graph and, once approved, run it.",
    ),
    "agent": (
        "running:agent",
        "Start the agent plane: compiles the graph, submits sessions, judges them. Ends with the goal's verdict.",
    ),
    "watch": ("running:watch", "Start the runtime plane: claims sessions, checks them, runs them. Ends with Ctrl-C."),
    "status": (
        "observing:status",
        "Show how a workspace stands: its runtime, emergency stop, goals, sessions, and what each worker does.",
    ),
    "runs": ("observing:runs", "List the workspaces here, the newest first, and those that run elsewhere."),
    "logs": ("observing:logs", "Print what the processes of a run have printed."),
    "preflight": (
        "preflight:preflight",
        "Check every session against its live target, without moving anything: plan and tools, or every problem.",
    ),
    "lint": ("authoring:lint", "Check authored files and report every problem with file, line and column."),
    "compile": (
        "authoring:compile_graph",
        "Show the DAG and the sessions that a goal graph would make; start nothing.",
    ),
    "plan": (
        "planning:plan",
        "Plan a goal by the effects of skills: sessions, their order, and why; start nothing.",
    ),
    "init": ("scaffolding:init", "Make a place of your own: a goal graph, a scene and a skill that run at once."),
    "describe": ("describing:describe", "Describe a leaf, skill, predicate, fault or setting by its own declaration."),
    "list": ("showing:list_names", "Print the names that can be used here, one a line."),
    "schema": (
        "showing:show_schema",
        "Print the JSON Schema of an authored file or a document; without a kind, the kinds.",
    ),
    "lifecycle": (
        "showing:show_lifecycle",
        "Print the statechart of a session, or of a target: the table that is also the code.",
    ),
    "why": (
        "explaining:why",
        "Explain a verdict: the layer, the leaf and the number that decided it; of a goal or node, the first cause.",
    ),
    "graph": (
        "explaining:show_graph",
        "Show a goal's graph as it stands: every attempt at a node, and what comes before it.",
    ),
    "view": (
        "viewing:view",
        "Show a workspace in the browser, before, during or after a run, until Ctrl-C; a token is printed.",
    ),
    "render": ("rendering:render", "Draw any moment of a session, or a film of sessions, from evidence alone."),
    "context": (
        "explaining:show_context",
        "Print what a model would be shown: request, world, open nodes, verdicts, capabilities, lessons, limits.",
    ),
    "rerun": (
        "explaining:rerun",
        "Run a session once more from its own documents and compare the bits of the terminal state.",
    ),
    "cancel": (
        "stopping:cancel",
        "Ask for an end: the robot is halted, then the session is cancelled; of a goal, every session of it.",
    ),
    "pause": (
        "stopping:pause",
        "Let a running session rest at the end of its present motion, until `resume`; its time limits go on.",
    ),
    "resume": ("stopping:resume", "Let a paused session go on."),
    "estop": (
        "stopping:estop",
        "Stop every target at once; it stays latched, over restarts, until `--reset`, which needs --workspace.",
    ),
    "edit": (
        "editing:edit",
        "Edit SESSIONS.md, with or without a runtime: limits and priority of pending sessions, ends, new sessions.",
    ),
    "amend": (
        "amending:amend",
        "Change the graph of a goal that is pursued: what has begun stays, everything else may become other nodes.",
    ),
    "judge": ("editing:judge", "Judge the executed sessions without a goal, which no agent looks at."),
    "doctor": (
        "doctor:examine_machine",
        "Check this machine: graphics, locks, file events, clock, versions, ports, disk; print each fix.",
    ),
    "codes": (
        "error_codes:show_codes",
        "Explain an error code: phase, meaning, who acts, whether trying again can help.",
    ),
    "approve": (
        "approving:approve",
        "Let a proposed goal run: shows it, asks, writes the approval, carries it out to its verdict.",
    ),
    "deny": ("approving:deny", "Refuse a proposed goal; that is recorded, and who proposed it is told why."),
    "mcp": (
        "mcp_server:serve",
        "Serve the tools of a workspace to an agent, over stdio or HTTP, until it hangs up or Ctrl-C.",
    ),
    "forecasts": (
        "forecasts:show_forecasts",
        "Compare what forecasters foresaw of sessions with what happened: Brier score, reliability, who is asked.",
    ),
    "verify": (
        "verification:verify",
        "Add a judgement to a session that has its verdict; erases none and changes no state.",
    ),
}
GROUPS: dict[str, tuple[str, dict[str, str]]] = {
    "tree": ("Behaviour trees.", {"show": "showing:show_tree"}),
    "evidence": ("Evidence bundles.", {"verify": "evidence:verify", "prune": "evidence:prune"}),
    "export": ("Verified sessions as data sets of others.", {"lerobot": "exporting:export_lerobot"}),
    "store": (
        "The journal of a workspace.",
        {"check": "store:check", "repair": "store:repair", "compact": "store:compact", "stats": "store:stats"},
    ),
    "robot": (
        "Profiles of robots.",
        {
            "list": "robots:list_robots",
            "show": "robots:show",
            "check": "robots:check",
            "render": "robots:render",
            "new": "robots:new",
        },
    ),
    "policy": ("Policies that carry out skills.", {"serve": "policies:serve", "replay": "policies:replay"}),
    "bench": (
        "Suites of many episodes on the ordinary path.",
        {
            "run": "bench:run",
            "resume": "bench:resume",
            "report": "bench:report",
            "compare": "bench:compare",
            "setup": "bench:setup",
        },
    ),
    "memory": (
        "What verdicts taught.",
        {
            "show": "memory:show",
            "why": "memory:why",
            "forget": "memory:forget",
            "promote": "memory:promote",
            "revoke": "memory:revoke",
        },
    ),
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
        lines = [(name, line) for name, (_, line) in COMMANDS.items()] + [(name, of[0]) for name, of in GROUPS.items()]
        room = formatter.width - 6 - max(len(name) for name, _ in lines)
        with formatter.section("Commands"):
            formatter.write_dl([(name, textwrap.shorten(line, room, placeholder="...")) for name, line in lines])


def load_command(name: str) -> Any:
    """A command, or a group of them, with its module loaded."""
    help_text, members = GROUPS.get(name, ("", {name: COMMANDS[name][0]} if name in COMMANDS else {}))
    made = typer.Typer(help=help_text or None, add_completion=False, **PLAIN)
    for each, place in members.items():
        module, function = place.split(":")
        made.command(each)(with_json(getattr(importlib.import_module(f"phyagentos.cli.{module}"), function)))
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
    version: bool = typer.Option(False, "--version", callback=_print_version, is_eager=True, help="Print the version."),
    debug: bool = typer.Option(False, "--debug", help="Show tracebacks."),
) -> None:
    del version
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
        return int(ExitCode.INVALID_INPUT)
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else int(ExitCode.INTERNAL_ERROR)
    if isinstance(error, typer.Abort):
        return int(ExitCode.INTERRUPTED)
    return int(report_exception(error, debug=is_debugging(sys.argv)))
