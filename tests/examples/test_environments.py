"""Examples 8 and 9: Meta-World and FrankaKitchen; that they run is for tests/extras, which have their environments."""

import importlib.util

import yaml

from phyagentos.bench.matrix import compile_suite
from phyagentos.operations.lint import lint_paths
from phyagentos.protocol.capabilities.library import find_shipped_root

EXAMPLES = find_shipped_root() / "examples" / "projects"
META_WORLD, KITCHEN = EXAMPLES / "08_meta_world", EXAMPLES / "09_franka_kitchen"


def test_a_table_of_tasks_becomes_a_suite_of_goal_graphs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    spec = importlib.util.spec_from_file_location("generate", META_WORLD / "generate.py")
    generate = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generate)
    table = yaml.safe_load((META_WORLD / "tasks.yaml").read_text())
    assert len(table["accept"]) == 50

    few = dict(list(table["accept"].items())[::12])
    plan = compile_suite(generate.write_project(tmp_path / "project", {**table, "accept": few}))
    assert [order.task for order in plan.orders] == [generate.name_of(task) for task in few]
    assert {problem.code for each in plan.missing.values() for problem in each} == {
        "EXTRA_MISSING",
        "POLICY_UNREACHABLE",
    }


def test_the_kitchen_lints_clean_and_its_chain_compiles():
    assert not lint_paths([KITCHEN]).problems
    plan = compile_suite(KITCHEN / "suite.yaml")
    assert len(plan.orders) == 5
