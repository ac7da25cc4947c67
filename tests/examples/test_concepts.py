"""The numbered examples: one concept and one page a file; each runs, and prints what its concept is about."""

import ast
import runpy
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
PAGE = 66  # lines
PRINTED = {
    "01_leaf": "{'object': 'near_cube'}\nno cup is known",
    "02_predicate": "far_out(far_cube): true, far_cube is 0.90 m in front of the robot",
    "03_tree": "squeeze/verify_grasp: FAILURE",
    "04_judge": "in time: false, it took 9 control periods",
    "05_scorer": "{'two seconds': True, 'half a second': False}",
    "06_policy": "after 175 rows: (25, 7) more, done: True",
    "07_skill": "2 files checked, no problem",
    "08_robot": "no problem",
    "09_driver": "stops_in_an_emergency: satisfied",
    "10_leader": "led at 0.2: 5 rows to 0.50\nled at 0.3: 27 rows to 0.60",
    "11_gamepad": "12 rows, 0.06 m away, opening 0.08 m, handed back: True",
}


def test_every_numbered_file_is_run_here():
    assert sorted(path.stem for path in EXAMPLES.glob("*.py")) == sorted(PRINTED)


@pytest.mark.parametrize("name", PRINTED)
def test_an_example_runs_and_prints_what_it_is_about(name, capsys):
    assert run(EXAMPLES / f"{name}.py") in {0, None}
    assert PRINTED[name] in capsys.readouterr().out


def run(path):
    """As Python runs it, in this process; its exit code where it has one."""
    try:
        runpy.run_path(str(path), run_name="__main__")
    except SystemExit as ended:  # where the command line itself is called
        return ended.code
    return 0


@pytest.mark.parametrize("name", PRINTED)
def test_an_example_is_one_page_that_says_how_it_is_run(name):
    text = (EXAMPLES / f"{name}.py").read_text()

    assert len(text.splitlines()) <= PAGE
    assert f"python examples/{name}.py" in ast.get_docstring(ast.parse(text))


def test_a_leaf_takes_at_most_fourteen_lines():
    (leaf,) = [node for node in ast.parse((EXAMPLES / "01_leaf.py").read_text()).body if isinstance(node, ast.ClassDef)]
    assert leaf.end_lineno - leaf.lineno + 1 <= 14
