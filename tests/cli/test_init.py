"""`paos init`: a place of one's own, complete and clean from the first moment."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from phyagentos.cli.outcome import ExitCode
from phyagentos.operations.init import Extension
from phyagentos.protocol.predicates.library import get_predicate_library
from phyagentos.protocol.predicates.project_predicates import forget_readings
from tests.command_line import assert_ended, assert_refused

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def own_predicates():
    """What a project brings is known to its test alone."""
    yield
    get_predicate_library.cache_clear()
    forget_readings()


@pytest.mark.slow
def test_a_new_place_lints_clean_and_compiles(paos, tmp_path):
    place = tmp_path / "mine"
    assert paos("init", place).code == ExitCode.GOAL_MET
    linted = paos("lint", place)
    assert (linted.code, linted.err) == (ExitCode.GOAL_MET, "")
    assert "4 files checked" in linted.out
    assert_ended(
        paos("compile", place / "goal_graphs" / "first.yaml"), ExitCode.GOAL_MET, out=["show: show_and_place("]
    )


def test_init_never_overwrites(paos, tmp_path):
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    assert_refused(paos("init", tmp_path), "WOULD_OVERWRITE: found a folder that is not empty")
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.slow
def test_the_next_command_that_init_prints_names_a_file_that_exists(paos, tmp_path):
    place = tmp_path / "mine"
    lines = paos("init", place).out.splitlines()
    assert lines[-1].startswith("next: ")
    assert Path(lines[-1].split()[-1]).is_file()
    assert f"wrote {place / 'scenes' / 'desk.png'}" in lines, "what was begun is seen at once"


@pytest.mark.slow
def test_the_scaffold_uses_the_skill_of_the_first_example_unchanged(paos, tmp_path):
    paos("init", tmp_path / "mine")
    for name in ("skills/show_and_place/SKILL.md", "trees/show_and_place.yaml"):
        mine = (tmp_path / "mine" / name).read_text(encoding="utf-8")
        assert mine == (ROOT / "examples/projects/01_yaml_skill" / name).read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.usefixtures("own_predicates")
def test_extensions_come_with_tests_that_pass_until_something_is_broken_and_files_that_lint_clean(paos, tmp_path):
    place = tmp_path / "mine"
    made = paos("init", place, *(word for extension in Extension for word in ("--with", extension)))
    assert (made.code, f"pytest {place / 'tests'}" in made.out) == (ExitCode.GOAL_MET, True)

    tested = run_tests(place)
    assert tested.returncode == 0, tested.stdout
    assert {file.name for file in (place / "tests").glob("test_*.py")} == set(
        re.findall(r"test_\w+\.py", tested.stdout)
    )
    linted = paos("lint", place, "--run-python")
    assert (linted.code, linted.err) == (ExitCode.GOAL_MET, ""), linted.err

    (file := place / "predicates" / "far_out.py").write_text(file.read_text().replace("REACH_M = 0.6", "REACH_M = 0.8"))
    broken = run_tests(place, "tests/test_predicate.py")
    assert "FAILED tests/test_predicate.py::test_it_holds_beyond_the_reach" in broken.stdout


@pytest.mark.slow
def test_an_extension_is_added_to_a_project_once(paos, tmp_path):
    place = tmp_path / "mine"
    paos("init", place)
    assert paos("init", place, "--with", "predicate").code == ExitCode.GOAL_MET
    again = paos("init", place, "--with", "predicate", "--with", "leaf")
    assert "far_out.py: WOULD_OVERWRITE" in again.err
    assert not (place / "skills" / "take_nearest").exists()


def run_tests(place, which="tests"):
    command = [sys.executable, "-m", "pytest", "-rA", "-p", "no:cacheprovider", "-p", "no:randomly", which]
    return subprocess.run(command, cwd=place, capture_output=True, text=True, check=False, timeout=300)
