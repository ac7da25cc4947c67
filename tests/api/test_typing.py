"""A type checker sees every name of the library, with its types, and no name that is not there."""

import subprocess
import sys
from pathlib import Path

import pytest

import phyagentos

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = """
import phyagentos as paos


def count_misses(root: str) -> dict[str, int]:
    misses: dict[str, int] = {}
    for session in paos.open_workspace(root):
        misses[session.node] = misses.get(session.node, 0) + (session.verdict == "replan")
        fastest: float = session.trajectory["qd_measured"].max()
        print(session.tree.svg, session.strategy.speed, session.criteria[0].truth.mark, fastest)
    return misses


report = paos.run("tidy_table", seed=7, faults="slip", overrides={"targets.arm": "ur5e"})
goal: paos.GoalView = paos.open_workspace(report.workspace).goals["tidy_table-7"]
print(paos.open_workspace(goal.workspace).replay("red").tree_at(1.0)["pick_and_place"].lower(), goal.graph.title)
"""


@pytest.fixture(scope="module")
def check(tmp_path_factory):
    """What `mypy --strict`, set up as for the package, says of a file; nothing where it finds nothing."""

    def run(text):
        file = tmp_path_factory.mktemp("typed") / "script.py"
        file.write_text(text)
        command = [sys.executable, "-m", "mypy", "--config-file", "pyproject.toml", "--no-error-summary", file]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode in {0, 1}, done.stderr
        return done.stdout.replace(f"{file}:", "").splitlines()

    return run


@pytest.mark.slow
def test_every_public_name_has_a_type_and_no_other_name_is_known(check):
    names = phyagentos.__all__
    told = check(EXAMPLE + "".join(f"reveal_type(paos.{name})\n" for name in names) + "paos.nonsense\npaos.run(3)\n")
    revealed, errors = told[: len(names)], told[len(names) :]
    revealed = [line.replace("Coroutine[Any, Any, ", "Coroutine[") for line in revealed]
    assert all("Revealed type is" in line and "Any" not in line and '"object"' not in line for line in revealed), told
    assert [line.partition("error: ")[2] for line in errors] == [
        'Module has no attribute "nonsense"  [attr-defined]',
        'Argument 1 to "run" has incompatible type "int"; expected "str | Path"  [arg-type]',
    ]
