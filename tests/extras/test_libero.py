"""One task of LIBERO, from its BDDL to a verdict, in the environment of `--libero-python`."""

import argparse
import re
import subprocess
from pathlib import Path

import pytest

from benchmarks.libero import is_final, run_task
from benchmarks.libero_parts.moment_cases import judge_again, judge_suite, open_verifier
from benchmarks.libero_parts.verdict_figures import read_case

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


def test_no_file_of_the_project_names_a_task_or_thing_of_it(pytestconfig):
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


def test_the_same_moments_of_a_task_get_the_same_verdicts_and_none_sees_its_label(tmp_path, pytestconfig):
    python = Path(pytestconfig.option.libero_python)
    judged = []
    for name in ("one", "two"):
        given = argparse.Namespace(python=python, results=tmp_path / "r.jsonl", keep=tmp_path / name, seed=1)
        (records,) = judge_suite(given, "libero_object", {0: [0]})
        judged.append([{key: record[key] for key in record.keys() - {"wall_s"}} for record in records])

    assert judged[0] == judged[1]
    cases = [read_case(record) for record in judged[0]]
    assert {case.success for case in cases} == {True, False}
    assert not any(case.is_wrong for case in cases if case.kind in {"start", "dropped", "wrong object"})
    hidden = [case for case in cases if case.kind == "occluded"]
    assert [case.said for case in hidden] == ["unknown"], "what is not seen is no success, and no failure"
    for path in (tmp_path / "one").glob("*/*/evidence/*/*.json*"):
        assert '"success"' not in path.read_text(), f"{path.name} tells what the scorer says"
    again = [judge_again(given, record, open_verifier()) for record in records]
    assert [each["said"] for each in again] == [each["said"] for each in records]
