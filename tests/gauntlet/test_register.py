"""The register of lies is sound: each can be planted, names tests that exist, and stands in the table for people."""

import ast
import subprocess
import sys
from functools import cache

from tests.gauntlet.running import Outcome, Run, plant, run_tests
from tests.gauntlet.sabotage import ROOT, Edit, Sabotage
from tests.gauntlet.sabotages import SABOTAGES
from tests.gauntlet.table import PAGE, render_page

SEED = "tests/agent/test_compiler.py::test_every_attempt_has_a_seed_and_an_id_of_its_own"
SEEDS = Sabotage(
    name="seeds",
    lie="Every seed is 7.",
    edits=(Edit("phyagentos.protocol.world.seeds", "    return int.from_bytes(", "    return 7 or int.from_bytes("),),
    tests=(SEED,),
)


def bend(edits):
    """The sources that a sabotage makes of its modules; two edits of one module are made one after the other."""
    sources = {}
    for edit in edits:
        sources[edit.path] = edit.apply(sources.get(edit.path) or edit.path.read_text(encoding="utf-8"))
    return sources


def test_a_lie_finds_the_lines_that_it_bends_and_leaves_python_behind():
    for sabotage in SABOTAGES:
        assert sabotage.edits, sabotage.name
        for path, source in bend(sabotage.edits).items():
            honest = path.read_text(encoding="utf-8")
            assert ast.dump(ast.parse(source)) != ast.dump(ast.parse(honest)), (sabotage.name, path)
            assert "from numba import" not in honest, "what numba compiles from bent source would stay in its cache"


def test_a_lie_names_tests_that_exist():
    for sabotage in SABOTAGES:
        assert sabotage.tests, sabotage.name
        for node in sabotage.tests:
            file, _, name = node.partition("[")[0].partition("::")
            assert name in list_tests(file), (sabotage.name, node)


@cache
def list_tests(file):
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    return {each.name for each in tree.body if isinstance(each, ast.FunctionDef)}


def test_no_two_lies_have_one_name():
    names = [sabotage.name for sabotage in SABOTAGES]

    assert len(names) == len(set(names)) >= 30


def test_the_table_for_people_is_that_of_the_register():
    assert PAGE.read_text(encoding="utf-8") == render_page(), "renew it: python -m tests.gauntlet --write"


def test_a_planted_lie_is_told_in_every_process_and_leaves_nothing_behind(tmp_path):
    tell = "from phyagentos.protocol.world.seeds import compute_seed; print(compute_seed(1))"
    ask_a_child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {tell!r}], check=True)"

    def ask(sabotage):
        command = [sys.executable, "-c", ask_a_child]
        environment = plant(sabotage, tmp_path)
        return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True).stdout

    honest = ask(None)
    assert ask(SEEDS) == "7\n"
    assert ask(None) == honest != "7\n"


def test_a_lie_that_cannot_be_planted_turns_nothing_red():
    for was, becomes in (("no such line", ""), ("    return int.from_bytes(", "    return int.from_bites(")):
        run = run_tests(
            (SEED,),
            Sabotage(name="s", lie="", edits=(Edit("phyagentos.protocol.world.seeds", was, becomes),), tests=(SEED,)),
        )
        assert not run.is_red(SEED)
        assert not run.is_green(SEED)


def test_red_is_what_a_test_says_and_not_what_breaks_on_the_way():
    run = Run((Outcome("f.py::a[1]", "passed"), Outcome("f.py::a[2]", "failed"), Outcome("f.py::b", "broken")), 0.0, "")

    assert (run.is_red("f.py::a"), run.is_red("f.py::a[1]"), run.is_red("f.py::b")) == (True, False, False)
    assert (run.is_green("f.py::a[1]"), run.is_green("f.py::a"), run.is_green("f.py::nobody")) == (True, False, False)
