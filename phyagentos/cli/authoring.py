"""Commands for people who write goals and skills: `lint` and `compile`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from phyagentos.assembly.project import get_file, open_library, parse_overrides
from phyagentos.cli.arguments import AsJson, Overrides, RunPython
from phyagentos.cli.outcome import ExitCode, print_json, print_note, print_problems, print_result

if TYPE_CHECKING:
    from phyagentos.agent.goals.graph import GoalGraph


def lint(
    paths: Annotated[list[Path], typer.Argument(metavar="FILE…", help="Files, or folders to walk.")],
    run_python: RunPython = False,
    as_json: AsJson = False,
) -> int:
    """Check authored files and report every problem with file, line and column."""
    from phyagentos.cli.lint import find_warnings, lint_paths

    checked, problems = lint_paths(paths, runs_python=run_python)
    if as_json:
        print_json({"checked": [str(path) for path in checked], "problems": problems})
    count = print_problems(problems)
    for warning in (each for path in checked for each in find_warnings(path)):
        print_note(f"warning: {warning}")
    if not checked:
        print_note("no authored file found")
        return int(ExitCode.INVALID_INPUT)
    files = f"{len(checked)} file{'s' if len(checked) != 1 else ''}"
    if count:
        print_note(f"{files} checked, {count} problem{'s' if count != 1 else ''}")
        return int(ExitCode.INVALID_INPUT)
    (print_note if as_json else print_result)(f"{files} checked, no problem")
    return int(ExitCode.GOAL_MET)


def compile_graph(
    graph: Annotated[Path, typer.Argument(help="A goal graph: a file, or a name of `paos list graphs`.")],
    set_: Overrides = None,
    mermaid: Annotated[bool, typer.Option("--mermaid", help="The DAG as a Mermaid flowchart.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Everything as JSON.")] = False,
) -> None:
    """Show the DAG and the sessions that a goal graph would make; start nothing."""
    from phyagentos.agent.goals.catalogue import Catalogue
    from phyagentos.agent.goals.graph import read_goal_graph, render_mermaid

    path = get_file(graph, "goal_graphs")
    compiled = read_goal_graph(path, Catalogue.read(open_library(path)), parse_overrides(set_))
    if mermaid:
        print_result(render_mermaid(compiled))
    elif as_json:
        print_json({"goal": compiled.name, "sessions": describe_nodes(compiled)})
    else:
        _print_graph(compiled)


def describe_nodes(graph: "GoalGraph") -> list[dict[str, Any]]:
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


def _print_graph(graph: "GoalGraph") -> None:
    print_result(f"{graph.name}: {graph.spec.objective}")
    for name, parameter in graph.spec.parameters.items():
        print_result(f"  --set {name}={parameter.default}: {parameter.type}  {parameter.description}".rstrip())
    for node in describe_nodes(graph):
        arguments = ", ".join(f"{key}={value}" for key, value in node["parameters"].items())
        waits = [*node["after"], *(f"{' or '.join(edge)} on failure" for edge in node["on_failure"])]
        after = f"  after {', '.join(waits)}" if waits else ""
        print_result(f"  {node['node']}: {node['skill']}({arguments}) on {node['target']}{after}")
        for text in node["accept"]:
            print_result(f"      accept {text}")
        for reason in node["because"]:
            print_result(f"      because {reason}")
        for candidate, reason in node["rejected"].items():
            print_result(f"      not {candidate}: {reason}")
    for text in graph.spec.accept:
        print_result(f"  goal accepts {text}")
