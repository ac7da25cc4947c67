"""Commands for people who write goals and skills: `init`, `lint` and `compile`."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phyagentos.assembly.project import get_file, parse_overrides
from phyagentos.cli.arguments import AsJson, Overrides, RunPython
from phyagentos.cli.outcome import ExitCode, print_found, print_json, print_note, print_problems, print_result
from phyagentos.protocol.documents.durable_files import require_empty

if TYPE_CHECKING:
    from phyagentos.operations.compile import CompiledGraph

TEMPLATES = Path(__file__).with_name("scaffold")


def init(folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder that is missing or empty.")]) -> None:
    """Make a place of your own: a goal graph, a scene and a skill that run at once."""
    require_empty(folder)
    shutil.copytree(TEMPLATES, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__", ".*"))
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        print_note(f"wrote {path}")
    print_result(f"next: paos lint {folder} && paos run {folder / 'goal_graphs' / 'first.yaml'}")


def lint(
    paths: Annotated[list[Path], typer.Argument(metavar="FILE…", help="Files, or folders to walk.")],
    run_python: RunPython = False,
    as_json: AsJson = False,
) -> int:
    """Check authored files and report every problem with file, line and column."""
    from phyagentos.bench.matrix import compile_suite
    from phyagentos.operations.lint import lint_paths

    found = lint_paths(paths, runs_python=run_python, check_suite=compile_suite)
    if as_json:
        print_json(found)
    count = print_problems(found.problems)
    for warning in found.warnings:
        print_note(f"warning: {warning}")
    if not found.checked:
        print_note("no authored file found")
        return ExitCode.INVALID_INPUT
    files = f"{len(found.checked)} file{'s' if len(found.checked) != 1 else ''}"
    if count:
        print_note(f"{files} checked, {count} problem{'s' if count != 1 else ''}")
        return ExitCode.INVALID_INPUT
    (print_note if as_json else print_result)(f"{files} checked, no problem")
    return ExitCode.GOAL_MET


def compile_graph(
    graph: Annotated[Path, typer.Argument(help="A goal graph: a file, or a name of `paos list graphs`.")],
    set_: Overrides = None,
    mermaid: Annotated[bool, typer.Option("--mermaid", help="The DAG as a Mermaid flowchart.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show the DAG and the sessions that a goal graph would make; start nothing."""
    from phyagentos.operations import compile as compiling

    found = compiling.compile_graph(get_file(graph, "goal_graphs"), parse_overrides(set_))
    print_found(found, found.mermaid if mermaid else "\n".join(_render(found)), as_json=as_json)


def _render(graph: "CompiledGraph") -> Iterator[str]:
    yield f"{graph.goal}: {graph.objective}"
    for name, parameter in graph.parameters.items():
        yield f"  --set {name}={parameter['default']}: {parameter['type']}  {parameter['description']}".rstrip()
    for node in graph.sessions:
        arguments = ", ".join(f"{key}={value}" for key, value in node.parameters.items())
        waits = [*node.after, *(f"{' or '.join(edge)} on failure" for edge in node.on_failure)]
        after = f"  after {', '.join(waits)}" if waits else ""
        yield f"  {node.node}: {node.skill}({arguments}) on {node.target}{after}"
        yield from (f"      accept {text}" for text in node.accept)
        yield from (f"      because {reason}" for reason in node.because)
        yield from (f"      not {candidate}: {reason}" for candidate, reason in node.rejected.items())
    yield from (f"  goal accepts {text}" for text in graph.accept)
