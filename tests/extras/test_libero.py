"""One task of LIBERO, from its BDDL to a verdict, in the environment of `--libero-python`."""

import argparse
import re
import subprocess
from pathlib import Path

import pytest

from benchmarks.libero import is_final, run_task

ROOT = Path(__file__).resolve().parents[2]
PLACES = ("phyagentos", "skills", "trees", "kits", "robots", "protocol", "benchmarks/libero_parts")
NAMES = """
import json
from pathlib import Path
from libero.libero import benchmark
from libero.libero.envs.bddl_utils import robosuite_parse_problem
names = set()
for suite in ("libero_spatial", "libero_object", "libero_goal", "libero_10"):
    tasks = benchmark.get_benchmark_dict()[suite]()
    for number in range(tasks.n_tasks):
        problem = robosuite_parse_problem(tasks.get_task_bddl_file_path(number))
        names |= {Path(tasks.get_task_bddl_file_path(number)).stem}
        for kind in ("objects", "fixtures"):
            names |= {each for group in problem[kind].values() for each in group} | set(problem[kind])
        names |= set(problem["regions"])
print("NAMES" + json.dumps(sorted(names)))
"""
PLAIN = {"floor", "table", "main_table", "basket", "plate", "milk", "butter", "ketchup", "cookies", "microwave"}
"""Words of everyday English, which say nothing of LIBERO."""

pytestmark = [pytest.mark.extras, pytest.mark.journey]


@pytest.mark.parametrize("sensing", ["state", "perceived"])
def test_a_task_is_done_and_its_own_scorer_agrees(tmp_path, pytestconfig, sensing):
    python = Path(pytestconfig.option.libero_python)
    options = {"results": tmp_path / "r.jsonl", "keep": tmp_path / "keep", "sensing": sensing, "policy": ""}
    given = argparse.Namespace(python=python, **options)

    (record,) = run_task(given, "libero_object", 0, [0])

    assert is_final(record), record
    evidence = next((tmp_path / "keep").glob("*/w0/evidence"))
    files = [path for path in evidence.rglob("*") if path.suffix in {".json", ".jsonl", ".yaml"}]
    assert files
    for path in files:
        assert '"success"' not in path.read_text(), f"{path.name} tells what the scorer says"


def test_no_file_of_the_project_names_a_task_or_object_of_it(pytestconfig):
    found = subprocess.run(
        [pytestconfig.option.libero_python, "-c", NAMES], capture_output=True, text=True, check=True
    ).stdout
    names = set(re.findall(r'"([^"]+)"', found.partition("NAMES")[2])) - PLAIN
    assert len(names) > 100
    pattern = re.compile(rf"\b({'|'.join(map(re.escape, sorted(names)))})\b")
    for place in PLACES:
        for path in sorted((ROOT / place).rglob("*")):
            if path.suffix in {".py", ".yaml", ".md", ".toml"}:
                assert not pattern.search(path.read_text()), f"{path}: {pattern.search(path.read_text())}"
