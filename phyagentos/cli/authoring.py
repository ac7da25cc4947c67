"""Commands for people who write goals and skills: `init`, `lint` and `compile`."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import GoalGraph, read_goal_graph, render_mermaid
from phyagentos.assembly.project import get_file, open_library, parse_overrides
from phyagentos.cli.arguments import AsJson, Overrides, RunPython
from phyagentos.cli.lint import find_warnings, lint_paths
from phyagentos.cli.outcome import ExitCode, print_found, print_json, print_note, print_problems, print_result
from phyagentos.protocol.documents.durable_files import require_empty

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
    checked, problems = lint_paths(paths, runs_python=run_python)
    if as_json:
        print_json({"checked": [str(path) for path in checked], "problems": problems})
    count = print_problems(problems)
    for warning in (each for path in checked for each in find_warnings(path)):
        print_note(f"warning: {warning}")
    if not checked:
        print_note("no authored file found")
        return ExitCode.INVALID_INPUT
    files = f"{len(checked)} file{'s' if len(checked) != 1 else ''}"
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
    path = get_file(graph, "goal_graphs")
    compiled = read_goal_graph(path, Catalogue.read(open_library(path)), parse_overrides(set_))
    if mermaid:
        print_result(render_mermaid(compiled))
    else:
        facts = {"goal": compiled.name, "sessions": describe_nodes(compiled)}
        print_found(facts, "\n".join(_render(compiled)), as_json=as_json)


def describe_nodes(graph: GoalGraph) -> list[dict[str, Any]]:
    """The sessions that a graph would make, as data."""
    return [
        {
            "node": name,
            "skill": graph.choices[name].skill,
            "target": graph.choices[name].target,
            "parameters": dict(graph.choices[name].parameters),
            "after": list(graph.nodes[name].after),
            "on_failure": [list(edge) for edge in graph.nodes[name].on_failure],
            "accept": list(graph.nodes[name].spec.accept),
            "because": list(graph.choices[name].reasons),
            "rejected": dict(graph.choices[name].rejected),
        }
        for name in graph.order
    ]


def _render(graph: GoalGraph) -> Iterator[str]:
    yield f"{graph.name}: {graph.spec.objective}"
    for name, parameter in graph.spec.parameters.items():
        yield f"  --set {name}={parameter.default}: {parameter.type}  {parameter.description}".rstrip()
    for node in describe_nodes(graph):
        arguments = ", ".join(f"{key}={value}" for key, value in node["parameters"].items())
        waits = [*node["after"], *(f"{' or '.join(edge)} on failure" for edge in node["on_failure"])]
        after = f"  after {', '.join(waits)}" if waits else ""
        yield f"  {node['node']}: {node['skill']}({arguments}) on {node['target']}{after}"
        yield from (f"      accept {text}" for text in node["accept"])
        yield from (f"      because {reason}" for reason in node["because"])
        yield from (f"      not {candidate}: {reason}" for candidate, reason in node["rejected"].items())
    yield from (f"  goal accepts {text}" for text in graph.spec.accept)
