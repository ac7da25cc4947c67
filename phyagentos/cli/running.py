"""Commands that move objects, one plane by hand: `agent` and `watch`."""

import signal
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.assembly.process_tuning import end_with
from phyagentos.assembly.project import admit_python, get_file, open_library, parse_overrides
from phyagentos.cli.arguments import Overrides, TrustPython
from phyagentos.cli.outcome import Exit, ExitCode, print_note
from phyagentos.cli.reply import Reply
from phyagentos.errors import DefinitionError
from phyagentos.protocol.settings.perception import Prior, Sensing
from phyagentos.protocol.settings.runtime_contract import WorldMode
from phyagentos.protocol.settings.verification_mode import VerificationMode
from phyagentos.protocol.workspace.foreign_python import find_foreign_predicates

_GOAL_HELP = "Id of the goal. One that has its verdict is only reported, so a restart does nothing twice."
_ASK_HELP = "Let verdicts wait for `paos answer`, as long as `answer_s` of the goal says."
_GRAPH = "A goal graph: a file, or a name of `paos list graphs`."
Graph = Annotated[Path, typer.Argument(help=_GRAPH, autocompletion=lambda: open_library().names_of_goal_graphs())]
Space = Annotated[Path, typer.Option("--workspace", "-w", help="Folder of the run; created when missing.")]
Seed = Annotated[int, typer.Option(help="Root of every random choice.", min=0, max=2**63 - 1)]
NoPictures = Annotated[bool, typer.Option("--no-pictures", help="Render nothing.")]
FaultFile = Annotated[Path | None, typer.Option("--faults", help="What shall go wrong in the simulated world.")]
WithParent = Annotated[int | None, typer.Option("--with-parent", hidden=True)]  # its process id: it may be gone
Mode = Annotated[WorldMode | None, typer.Option(help="How simulated time advances; kept in runtime_contract.yaml.")]
Sense = Annotated[Sensing | None, typer.Option(help="What agent and verifier see; kept in perception.yaml.")]
Known = Annotated[Prior | None, typer.Option(help="What perception knows at first; kept in perception.yaml.")]
Verify = Annotated[VerificationMode | None, typer.Option(help="What judgements are for, over runtime_contract.yaml.")]
_MEMORY_HELP = "Whose memory: `project`, `workspace`, `none`, or a folder; over runtime_contract.yaml."
WhichMemory = Annotated[str | None, typer.Option("--memory", help=_MEMORY_HELP, envvar="PHYAGENTOS_MEMORY")]


def agent(
    graph: Graph,
    workspace: Space,
    seed: Seed = 0,
    set_: Overrides = None,
    goal: Annotated[str | None, typer.Option(help=_GOAL_HELP)] = None,
    with_parent: WithParent = None,
    verify: Verify = None,
    memory: WhichMemory = None,
    ask: Annotated[bool, typer.Option("--ask", help=_ASK_HELP)] = False,
    trust_python: TrustPython = False,
) -> Reply[object]:
    """Start the agent plane: compiles the graph, submits sessions, judges them. Ends with the goal's verdict."""
    from phyagentos.assembly.agent_plane import run_agent

    about = f"agent of {workspace}: submits, judges; `paos watch -w {workspace}` carries out; Ctrl-C ends"
    _prepare(with_parent, about, by=signal.SIGKILL)  # a signal to end would cancel the goal, which can be continued
    file, overrides = get_file(graph, "goal_graphs"), parse_overrides(set_)
    admit_python(workspace, file, is_trusted=trust_python, announce=print_note, find=find_foreign_predicates)
    report = run_agent(
        workspace,
        file,
        seed,
        overrides=overrides,
        goal=goal,
        verify=verify,
        memory=memory,
        waits_for_answers=ask,
    )
    text = f"goal {report.goal}: {report.verdict}  {report.reason}"
    return Reply(report, text, code=ExitCode(report.exit_code))


def watch(
    workspace: Space,
    faults: FaultFile = None,
    no_pictures: NoPictures = False,
    once_idle: Annotated[bool, typer.Option(help="End when no goal and no session is left.")] = False,
    with_parent: WithParent = None,
    world_mode: Mode = None,
    sense: Sense = None,
    trust_python: TrustPython = False,
    expect: Annotated[list[str] | None, typer.Option(help="Start this target before a session waits for it.")] = None,
) -> None:
    """Start the runtime plane: claims sessions, checks them, runs them. Ends with Ctrl-C."""
    from phyagentos.assembly.runtime_plane import run_watch
    from phyagentos.operations.lint import FileKind, find_other_kind, lint_file

    file = get_file(faults, "faults") if faults is not None else None
    if file is not None and (problems := find_other_kind(file, FileKind.FAULTS) or lint_file(file)):
        raise DefinitionError(problems)
    _prepare(with_parent, f"runtime of {workspace}: claims, checks and runs what an agent submits; Ctrl-C ends")
    admit_python(workspace, is_trusted=trust_python, announce=print_note)
    run_watch(
        workspace,
        faults=file,
        pictures=not no_pictures,
        once_idle=once_idle,
        world_mode=world_mode,
        sense=sense,
        outlived=with_parent is None,  # with a parent no other process would start another one
        expected=expect or (),
    )


def _prepare(parent: int | None, about: str, by: signal.Signals = signal.SIGTERM) -> None:
    """With a parent, end `by` a signal when it ends; without one, say what begins."""
    if parent is None:
        print_note(about)
    elif not end_with(parent, by):
        raise Exit(ExitCode.INTERRUPTED)
