"""`paos`: the commands, assembled. One table names them all; `main` maps outcomes to exit codes.

Commands import their planes when they run, so that `paos --help` loads no solver and `paos agent` no simulator.
"""

import ast
import functools
import inspect
import os
import pkgutil
import re
import signal
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_origin

import typer
from typer.core import TyperGroup
from typing_extensions import override

from phyagentos.cli.outcome import ExitCode, print_json, report_exception, take_every_text
from phyagentos.protocol.documents.plain_data import Fields

PLAIN: Fields = {"no_args_is_help": True, "rich_markup_mode": None, "pretty_exceptions_enable": False}
EXPORTS = ("bt_xml", "html", "lerobot", "mcap", "mermaid", "rrd", "video")
GROUPS = {  # name -> help, module and functions
    "memory": ("What verdicts taught.", "memory", ("show", "why", "forget", "promote", "revoke")),
    "tree": ("Behaviour trees.", "showing", ("show", "serve")),
    "scene": ("Scenes: how they look and begin.", "scene_files", ("render", "check", "save")),
    "robot": (
        "Profiles of robots.",
        "robots",
        ("list_", "show", "check", "render", "try_", "new", "ros2", "lerobot", "calibrate"),
    ),
    "export": ("Trees, goals and sessions as files for the tools of others.", "exporting", EXPORTS),
    "evidence": ("Evidence bundles.", "keeping", ("verify", "prune")),
    "store": ("The journal of a workspace.", "keeping", ("check", "repair", "compact", "follow")),
    "ros2": ("Goals as a ROS 2 action; verdicts on what topics show.", "ros2", ("serve", "watch")),
    "fleet": ("Targets on other hosts, over NATS.", "fleet", ("server", "lead", "join", "status", "stop")),
    "policy": ("Policies that carry out skills.", "policies", ("serve", "replay")),
    "bench": (
        "Suites of many episodes on the ordinary path.",
        "bench",
        ("run", "resume", "report", "compare", "setup"),
    ),
}
GROUP = ""
SECTIONS = {  # of the help -> name -> module and function, the first line of whose docstring is its help; or a group
    "Run": {
        "run": "mission_run:run",
        "ask": "asking:ask",
        "plan": "planning:plan",
        "preflight": "preflight:preflight",
    },
    "See": {
        "help": "helping:explain",
        "why": "explaining:why",
        "status": "observing:status",
        "runs": "observing:runs",
        "logs": "observing:logs",
        "graph": "explaining:show_graph",
        "view": "viewing:view",
        "render": "exporting:render",
        "memory": GROUP,
    },
    "Author": {
        "init": "authoring:init",
        "lint": "authoring:lint",
        "compile": "authoring:compile_graph",
        "list": "showing:list_names",
        "describe": "showing:describe",
        "schema": "showing:show_schema",
        "tree": GROUP,
        "scene": GROUP,
        "robot": GROUP,
        "import": "exporting:import_tree",
        "export": GROUP,
    },
    "Control": {
        "cancel": "stopping:cancel",
        "pause": "stopping:pause",
        "take-over": "taking_over:take_over",
        "resume": "stopping:resume",
        "estop": "stopping:estop",
        "approve": "deciding:approve",
        "deny": "deciding:deny",
        "answer": "judging:answer",
        "contest": "judging:contest",
        "amend": "deciding:amend",
        "edit": "editing:edit",
    },
    "Expert": {
        "doctor": "doctor:examine_machine",
        "agent": "running:agent",
        "watch": "running:watch",
        "mcp": "mcp_server:serve",
        "verify": "judging:verify",
        "judge": "judging:judge",
        "rerun": "judging:rerun",
        "context": "explaining:show_context",
        "archive": "keeping:archive",
        "restore": "keeping:restore",
        "evidence": GROUP,
        "store": GROUP,
        "ros2": GROUP,
        "fleet": GROUP,
        "policy": GROUP,
        "bench": GROUP,
        "lifecycle": "showing:show_lifecycle",
        "codes": "showing:show_codes",
    },
}
COMMANDS = {name: at for each in SECTIONS.values() for name, at in each.items() if at}
MEMBERS = {  # of groups, as they are typed -> module and function
    group: {each.rstrip("_").replace("_", "-"): f"{module}:{each}" for each in functions}
    for group, (_, module, functions) in GROUPS.items()
}
PLACES = COMMANDS | {f"{group} {name}": at for group, each in MEMBERS.items() for name, at in each.items()}
SERVERS = (
    "watch",
    "view",
    "mcp",
    "policy serve",
    "tree serve",
    "ros2 serve",
    "ros2 watch",
    "fleet lead",
    "fleet join",
)  # until Ctrl-C: without a result
FORKING = ("run",)  # their processes are forks of a server, which loads beside the command itself
HELP = """Robots run on sessions that are verified, not merely finished.

\b
Begin with
  paos run tidy_table  a goal, carried out to its verdict
  paos why             what decided that verdict
  paos init DIR        a project of your own
  paos help WORDS      how to do it: paos help slower arm
"""


class Commands(TyperGroup):
    """The commands, of which only that which is called is loaded; to list them needs none."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        names: Any = dict.fromkeys([*COMMANDS, *GROUPS])  # a slip is compared with them
        self.commands = names

    @override
    def list_commands(self, ctx: object) -> list[str]:
        return list(self.commands)

    @override
    def get_command(self, ctx: object, cmd_name: str) -> Any:
        return load_command(cmd_name) if cmd_name in self.commands else None

    @override
    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if args[0] in FORKING and not (ctx.resilient_parsing or {*ctx.help_option_names} & {*args}):
            from phyagentos.assembly.libraries import LIBRARIES
            from phyagentos.fork_server import fork_server

            ctx.with_resource(fork_server(LIBRARIES))
        return super().resolve_command(ctx, args)

    @override
    def format_commands(self, ctx: object, formatter: Any) -> None:
        width = max(map(len, self.commands))
        room = formatter.width - 6 - width
        for title, names in SECTIONS.items():
            lines = [(f"{name:<{width}}", _shorten(read_summary(name), room)) for name in names]
            with formatter.section(title):
                formatter.write_dl(lines)


def _shorten(text: str, room: int) -> str:
    """As many of its clauses as there is room for; else as many words."""
    ends = [each.start() for each in re.finditer("[:;] ", text) if each.start() <= room]
    return text if len(text) <= room else text[: ends[-1]] if ends else textwrap.shorten(text, room, placeholder="...")


def read_summary(name: str) -> str:
    """The first line of a command's docstring, from its source: nothing is imported."""
    if name in GROUPS:
        return GROUPS[name][0]
    module, _, function = COMMANDS[name].partition(":")
    return read_summaries(module)[function]


@functools.cache
def read_summaries(module: str) -> dict[str, str]:
    """The first lines of the docstrings of a module's functions."""
    tree = ast.parse(Path(__file__).with_name(f"{module}.py").read_text(encoding="utf-8"))
    functions = [each for each in tree.body if isinstance(each, ast.FunctionDef)]
    return {each.name: (ast.get_docstring(each) or "").partition("\n")[0] for each in functions}


def load_command(name: str) -> Any:
    """A command, or a group of them, with its module loaded."""
    made = typer.Typer(help=GROUPS[name][0] if name in GROUPS else None, add_completion=False, **PLAIN)
    for each, place in (MEMBERS.get(name) or {name: COMMANDS[name]}).items():
        made.command(each)(answering(pkgutil.resolve_name(f"phyagentos.cli.{place}")))
    if name in GROUPS:
        made.callback()(lambda: None)
    return typer.main.get_command(made)


app = typer.Typer(
    name="paos",
    help=HELP,
    cls=Commands,
    **PLAIN,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
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


def answering(command: Callable[..., object]) -> Callable[..., object]:
    """A command whose reply is printed, as JSON with `--json`; one without a reply prints by itself."""
    from phyagentos.cli.arguments import AsJson
    from phyagentos.cli.reply import Reply

    signature = inspect.signature(command)
    if get_origin(signature.return_annotation) is not Reply:
        return command

    @functools.wraps(command)
    def call(*, as_json: bool, **arguments: object) -> object:
        reply = command(**arguments)
        return reply.print(as_json=as_json) if isinstance(reply, Reply) else reply

    own = inspect.Parameter("as_json", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=AsJson)
    call.__dict__["__signature__"] = signature.replace(parameters=[*signature.parameters.values(), own])
    call.__annotations__ = command.__annotations__ | {"as_json": AsJson}
    return call


def main() -> None:
    """Entry point of the console script `paos`."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as Ctrl-C does: temporary folders are removed
    take_every_text()
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
        if nearest := getattr(error, "possibilities", None):
            error.__dict__.update(
                possibilities=None, message=f"{error}. Did you mean {' or '.join(map(repr, nearest))}?"
            )
        _rephrase(error)
        show()
        return ExitCode.INVALID_INPUT
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else int(ExitCode.INTERNAL_ERROR)
    if isinstance(error, typer.Abort):
        return ExitCode.INTERRUPTED
    return int(report_exception(error))


def _rephrase(error: BaseException) -> None:
    """Say of a wrong argument what was found and is expected, of an unknown command of a group which there are."""
    from phyagentos.protocol.documents.schema import phrase

    for each in getattr(error.__cause__, "errors", list)()[:1]:
        choices = re.findall(r"'(\w+)'", str(each.get("ctx")).partition(" not one of ")[2])
        expected = f"one of {', '.join(choices)}" if choices else phrase(each["type"], each.get("ctx", {}))
        error.__dict__["message"] = f"found {each['input']!r}; expected {expected}."
    members = MEMBERS.get(getattr(getattr(error, "ctx", None), "info_name", ""))
    if members and "No such command" in getattr(error, "message", ""):
        error.__dict__["message"] += f" There are {', '.join(members)}."
