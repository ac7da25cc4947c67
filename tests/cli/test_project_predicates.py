"""Predicates in the project's own folder: executed with consent alone, and known to whatever reads a criterion then."""

import pytest

from phyagentos.assembly.project import admit_python, open_library
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.predicates.library import get_predicate_library
from phyagentos.protocol.predicates.predicate import parse_predicate
from phyagentos.protocol.predicates.project_predicates import forget_readings, load_predicates
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.testing import make_cube, make_world
from tests.command_line import assert_refused

PYTHON = """
from pathlib import Path
from phyagentos.predicates import Argument, ArgumentKind, PredicateDefinition, Reading
Path(__file__).with_name("ran").touch()


def measure_far_out(view, a):
    return Reading(a.pose.position_m[0] - 0.6, {"x_m": a.pose.position_m[0]}, f"{a.name} is far out")


FAR_OUT = PredicateDefinition(
    name="far_out", arguments=(Argument("a", ArgumentKind.ENTITY),), measure=measure_far_out, description="Far out."
)
"""
GRAPH = """goal: reach_out
objective: Carry the red cube far out.
scene: tabletop/cubes_and_trays
targets: {arm: panda}
sessions:
  out:
    skill: pick_and_place
    target: arm
    with: {object: red_cube, destination: red_tray}
    accept: [far_out(red_cube)]
"""


@pytest.fixture
def project(tmp_path, monkeypatch):
    root = tmp_path / "project"
    for name, text in {"predicates/far_out.py": PYTHON, "goal_graphs/reach_out.yaml": GRAPH}.items():
        (root / name).parent.mkdir(parents=True)
        (root / name).write_text(text)
    monkeypatch.chdir(root)
    get_predicate_library.cache_clear()  # of what tests of scaffolds and examples leave
    forget_readings()
    yield root
    get_predicate_library.cache_clear()
    forget_readings()


def has_run(project):
    return (project / "predicates" / "ran").exists()


@pytest.mark.parametrize("command", ["lint", "compile"])
def test_without_consent_nothing_is_executed_and_the_error_names_the_option(paos, project, command):
    assert_refused(
        paos(command, "goal_graphs/reach_out.yaml"),
        "UNKNOWN_NAME (predicate): found 'far_out'",
        "predicates/far_out.py defines it: read it; --run-python executes it.",
    )
    assert not has_run(project)


@pytest.mark.parametrize("command", ["lint", "compile"])
def test_with_consent_it_is_known(paos, project, command):
    assert (done := paos(command, "goal_graphs/reach_out.yaml", "--run-python")).code == 0, done.err
    assert has_run(project)
    assert "far_out(a)" in paos("list", "predicates", "--run-python").out


def test_a_run_of_ones_own_project_executes_it_as_it_executes_leaves(project):
    admit_python(project / "w", project / "goal_graphs" / "reach_out.yaml", is_trusted=False)

    far, near = (make_world(make_cube("a", (x_m, 0.0, 0.02))) for x_m in (0.7, 0.5))
    assert [str(parse_predicate("far_out(a)").evaluate(View(now=world)).truth) for world in (far, near)] == [
        "true",
        "false",
    ]


def test_a_suite_of_ones_own_project_knows_it(paos, project):
    (project / "suite.yaml").write_text(
        "suite: reach\nobjective: A reach.\nscorer: simulator\nseeds: [1]\ntasks:\n"
        "  out: {graph: reach_out, score: {red: {in_tray: [red_cube, red_tray]}}}\n"
    )

    assert (done := paos("bench", "run", "suite.yaml", "--dry-run")).code == 0, done.err
    assert "1 episode," in done.out


def test_a_workspace_carries_a_copy_which_elsewhere_runs_only_with_the_option(project, tmp_path, monkeypatch):
    workspace = Workspace.create(tmp_path / "w", open_library())
    assert (workspace.library_root / "predicates" / "far_out.py").is_file()
    monkeypatch.chdir(tmp_path)

    with pytest.raises(DefinitionError, match=r"far_out\.py: UNTRUSTED_PYTHON.*--trust-python lets it run"):
        admit_python(workspace.root, is_trusted=False)
    assert get_predicate_library().find("far_out") is None
    admit_python(workspace.root, is_trusted=True)
    assert get_predicate_library().find("far_out") is not None


def test_the_latest_project_has_the_name_and_a_shipped_one_keeps_its_own(project):
    path = project / "predicates" / "far_out.py"
    load_predicates([path])
    path.write_text(PYTHON.replace("Far out.", "Beyond."))
    load_predicates([path])
    assert get_predicate_library().find("far_out").description == "Beyond."

    path.write_text(PYTHON.replace('"far_out", arg', '"inside", arg'))
    with pytest.raises(DefinitionError, match="DUPLICATE_NAME: found 'inside'"):
        load_predicates([path])


def test_a_file_that_does_not_load_is_named(project):
    (project / "predicates" / "far_out.py").write_text("\n1 / 0")
    with pytest.raises(DefinitionError, match=r"far_out\.py:2: BROKEN_PYTHON: found loading it raised ZeroDivision"):
        load_predicates(Library((project, find_shipped_root())).iter_predicates())
