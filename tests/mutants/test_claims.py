"""The list of mutants is sound: each can be planted, names tests that exist, and stands in the table for people."""

import ast
import subprocess
import sys
from functools import cache

import pytest

from tests.mutants.mutant import ROOT, Edit, Mutant
from tests.mutants.page import PAGE, render_page
from tests.mutants.register import MUTANTS
from tests.mutants.running import Outcome, Run, plant

SEEDS = Edit("phyagentos.protocol.world.seeds", "return int.from_bytes(", "return 7 or int.from_bytes(")


@pytest.mark.slow
def test_a_mutant_finds_the_lines_that_it_bends_and_leaves_python_behind():
    for mutant in MUTANTS:
        assert mutant.edits, mutant.name
        bent = mutant.bend()
        for edit in mutant.edits:
            honest = read_source(edit.path)
            assert ast.dump(ast.parse(bent[edit.module])) != dump(honest), (mutant.name, edit.path)
            assert "from numba import" not in honest, "what numba compiles from bent source would stay in its cache"


@cache
def read_source(path):
    return path.read_text(encoding="utf-8")


@cache
def dump(source):
    return ast.dump(ast.parse(source))


def test_a_mutant_names_tests_that_exist():
    for mutant in MUTANTS:
        assert mutant.tests, mutant.name
        for node in mutant.tests:
            file, _, name = node.partition("[")[0].partition("::")
            assert name in list_tests(file), (mutant.name, node)


@cache
def list_tests(file):
    tree = ast.parse(read_source(ROOT / file))
    return {each.name for each in tree.body if isinstance(each, ast.FunctionDef)}


def test_no_two_mutants_have_one_name():
    names = [mutant.name for mutant in MUTANTS]

    assert len(names) == len(set(names)) >= 100


def test_the_table_for_people_is_that_of_the_register():
    assert PAGE.read_text(encoding="utf-8") == render_page(), "renew it: python -m tests.mutants --write"


def test_lines_are_found_however_they_are_wrapped():
    assert Edit("m", "if (a\n    and b):", "if a:").apply("    if (a and\tb):\n") == "    if a:\n"


@pytest.mark.parametrize("source", ["", "a = 1\na = 1\n"])
def test_lines_that_do_not_stand_exactly_once_are_an_error(source):
    with pytest.raises(ValueError, match="expected once"):
        Edit("m", "a = 1", "a = 2").apply(source)


@pytest.mark.slow
def test_a_planted_mutant_is_in_every_process_and_leaves_nothing_behind(tmp_path):
    tell = "from phyagentos.protocol.world.seeds import compute_seed; print(compute_seed(1))"
    ask_a_child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {tell!r}], check=True)"

    def ask(mutant):
        command = [sys.executable, "-c", ask_a_child]
        environment = plant(mutant, tmp_path)
        return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True).stdout

    honest = ask(None)
    assert ask(Mutant(name="seeds", claim="Every seed is 7.", edits=(SEEDS,), tests=())) == "7\n"
    assert ask(None) == honest != "7\n"


def test_red_is_what_a_test_says_and_not_what_breaks_on_the_way():
    run = Run((Outcome("f.py::a[1]", "passed"), Outcome("f.py::a[2]", "failed"), Outcome("f.py::b", "broken")), 0.0, "")

    assert (run.is_red("f.py::a"), run.is_red("f.py::a[1]"), run.is_red("f.py::b")) == (True, False, False)
    assert (run.is_green("f.py::a[1]"), run.is_green("f.py::a"), run.is_green("f.py::missing")) == (True, False, False)
