"""Commands for people who write goals and skills: `init`, `lint` and `compile`."""

from collections.abc import Iterator
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from msgspec.structs import replace

from phyagentos.assembly.project import get_file, parse_overrides
from phyagentos.cli.arguments import Overrides, RunPython
from phyagentos.cli.exporting import draw_without_screen
from phyagentos.cli.outcome import ExitCode
from phyagentos.cli.reply import Reply
from phyagentos.errors import DefinitionError
from phyagentos.operations.init import Extension
from phyagentos.wording import count

if TYPE_CHECKING:
    from phyagentos.operations.compile import CompiledGraph


def init(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder that is missing or empty, or a project.")],
    extensions: Annotated[
        list[Extension] | None, typer.Option("--with", help="An extension, with its test. Repeatable.")
    ] = None,
) -> Reply[object]:
    """Make a place of your own: a goal graph, a scene and a skill that run at once."""
    from phyagentos.operations.init import init

    found = init(folder, extensions or ())
    with suppress(DefinitionError, StopIteration):  # no scene was written, or nothing can be drawn here
        scene = next(path for path in map(Path, found.files) if path.parent.name == "scenes")
        draw_without_screen()
        from phyagentos.operations.scene_files import render

        found = replace(found, files=(*found.files, str(render(scene, scene.with_suffix(".png")).file)))
    install = "" if find_spec("pytest") else "pip install pytest && "  # which no run needs
    test = f"{install}pytest {found.tests} && " if found.tests else ""
    steps = f"next: {test}paos lint {folder} && paos run {found.graph}"
    return Reply(found, "\n".join([*(f"wrote {each}" for each in found.files), steps]))


def lint(
    paths: Annotated[list[Path], typer.Argument(metavar="FILE…", help="Files, folders to walk, names of goal graphs.")],
    run_python: RunPython = False,
) -> Reply[object]:
    """Check authored files and report every problem with file, line and column."""
    from phyagentos.bench.matrix import compile_suite
    from phyagentos.operations.lint import lint_paths

    files = [get_file(each, "goal_graphs") if each.name == str(each) and not each.exists() else each for each in paths]
    found = lint_paths(files, runs_python=run_python, check_suite=compile_suite)
    problems = list(dict.fromkeys(str(each).replace("\n", " ") for each in found.problems))
    notes = [*problems, *(f"warning: {each}" for each in found.warnings)]
    checked = f"{count(len(found.checked), 'file')} checked"
    if found.checked and not problems:
        return Reply(found, f"{checked}, no problem", notes)
    last = f"{checked}, {count(len(problems), 'problem')}" if problems else "no authored file found"
    return Reply(found, notes=[*notes, last], code=ExitCode.INVALID_INPUT)


def compile_graph(
    graph: Annotated[Path, typer.Argument(help="A goal graph: a file, or a name of `paos list graphs`.")],
    set_: Overrides = None,
    mermaid: Annotated[bool, typer.Option("--mermaid", help="The DAG as a Mermaid flowchart.")] = False,
    run_python: RunPython = False,
) -> Reply[object]:
    """Show the DAG and the sessions that a goal graph would make; start nothing."""
    from phyagentos.operations import compile as compiling

    found = compiling.compile_graph(get_file(graph, "goal_graphs"), parse_overrides(set_), runs_python=run_python)
    return Reply(found, found.mermaid if mermaid else "\n".join(_render(found)), folds=not mermaid)


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
