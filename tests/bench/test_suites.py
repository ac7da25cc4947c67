"""Suites as files: what is wrong stands at its place, what is not here is counted, figures are what records say."""

import contextlib
import json
import os

import msgspec
import pytest
import yaml

from phyagentos.agent.judging.causes import Cause
from phyagentos.bench.availability import find_lacks, plan_setup
from phyagentos.bench.engines import EngineName, open_engine
from phyagentos.bench.held import compare_held
from phyagentos.bench.matrix import compile_suite
from phyagentos.bench.records import LOG, EpisodeLog, EpisodeRecord, Held, SessionRecord, read_records
from phyagentos.bench.scorers.scorer import FILE, OUTCOMES
from phyagentos.bench.scoring import Taxon, classify_cause, classify_problems
from phyagentos.bench.suite_file import FigureThreshold, Policy, Variant, merge
from phyagentos.bench.summary import compare, compute_figure, count_repeats, follow_seeds
from phyagentos.bench.sweep import begin_run, run_sweep
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, ExecutionError, Problem
from phyagentos.fork_server import ADDRESS
from phyagentos.protocol.capabilities.environments import EnvironmentSpec
from tests.bench.suite_of_counter import SUITE, make_project

TIDY = {"graph": "tidy_table", "score": {"red": {"in_tray": ["red_cube", "red_tray"]}}}


@pytest.fixture
def read(tmp_path, monkeypatch):
    """Compiles a suite of `tidy_table` in which some keys are replaced; of the simulator's scorer."""
    monkeypatch.chdir(tmp_path)

    def compile_changed(**changes):
        path = tmp_path / "suite.yaml"
        suite = {**SUITE, "tasks": {"tidy": TIDY}, "scorer": "simulator", **changes}
        path.write_text(yaml.safe_dump(suite, sort_keys=False))
        return compile_suite(path)

    return compile_changed


def test_the_matrix_is_the_product_of_its_axes_in_order(read):
    plan = read(
        tasks={"tidy": TIDY, "again": {**TIDY, "initial_states": {"near": {}, "far": {}}}},
        policies={"a": {}, "b": {}},
        settings={"x": {}, "y": {}},
        verification=["off", "recovery"],
        seeds={"first": 5, "count": 2},
    )

    assert len(plan.orders) == len({order.id for order in plan.orders}) == (1 + 2) * 2 * 2 * 2 * 2
    assert plan.orders[0].id == "tidy.a.x.off.5"
    assert plan.orders[-1].id == "again.far.b.y.recovery.6"
    assert plan.orders[-1].goal == "again-6"


def test_of_each_pass_only_the_first_seeds_are_run_where_so_many_are_asked_for(read, tmp_path):
    read(seeds={"first": 5, "count": 9}, passes={"own": {"seeds": [3, 1, 2]}, "common": {}})
    plan = compile_suite(tmp_path / "suite.yaml", 2)

    assert [order.id for order in plan.orders] == ["own.tidy.3", "own.tidy.1", "common.tidy.5", "common.tidy.6"]


def test_of_two_axes_that_say_the_same_the_later_one_is_heard():
    merged = merge(
        [
            Variant(set={"a": 1, "b": 1}, files={"safety.yaml": {"x": 1, "y": 1}}, sense="truth", needs=("m",)),
            Variant(set={"b": 2}, files={"safety.yaml": {"y": 2}}, pictures=False, needs=("n",)),
        ]
    )

    assert merged.set == {"a": 1, "b": 2}
    assert merged.files == {"safety.yaml": {"x": 1, "y": 2}}
    assert (merged.sense, merged.pictures, merged.needs) == ("truth", False, ("m", "n"))


def test_a_setting_is_heard_after_its_pass_which_may_name_tasks_and_a_task_has_its_own_scorer(read):
    plan = read(
        tasks={"tidy": TIDY, "judged": {**TIDY, "scorer": "verdict", "score": {"all": "success"}}},
        settings={"full": {}, "forgets": {"memory": "none"}},
        passes={"learn": {"memory": "adapting"}, "after": {"memory": "frozen", "tasks": ["judged"]}},
        seeds=[0],
    )

    assert {order.id: (order.memory, order.scorer) for order in plan.orders} == {
        "learn.tidy.full.0": ("adapting", "simulator"),
        "learn.tidy.forgets.0": ("none", "simulator"),
        "learn.judged.full.0": ("adapting", "verdict"),
        "learn.judged.forgets.0": ("none", "verdict"),
        "after.judged.full.0": ("frozen", "verdict"),
        "after.judged.forgets.0": ("none", "verdict"),
    }
    assert [order.id for order in plan.orders if order.chain] == ["learn.tidy.full.0", "learn.judged.full.0"]


MISTAKES = {
    "a graph": ({"tasks": {"tidy": {**TIDY, "graph": "tidy_tabel"}}}, "UNKNOWN_NAME (file)", 5, "tidy_table"),
    "a condition": (
        {"tasks": {"tidy": {**TIDY, "score": {"red": {"in_trey": []}}}}},
        "UNKNOWN_NAME (condition)",
        8,
        "in_tray",
    ),
    "its arguments": ({"tasks": {"tidy": {**TIDY, "score": {"red": {"in_tray": ["x"]}}}}}, "INVALID_VALUE", 8, ""),
    "a scorer": ({"scorer": "simulater"}, "UNKNOWN_NAME (scorer)", 13, "simulator"),
    "a scorer of a task": (
        {"tasks": {"tidy": {**TIDY, "scorer": "simulater"}}},
        "UNKNOWN_NAME (scorer)",
        11,
        "simulat",
    ),
    "a task of a pass": ({"passes": {"x": {"tasks": ["tidi"]}}}, "UNKNOWN_NAME (task)", 16, "tidy"),
    "a repair": ({"common": {"repair": "repare"}}, "UNKNOWN_NAME (repair policy)", 15, "repair"),
    "a module": ({"common": {"repair": "no_such_module:Repair"}}, "UNKNOWN_NAME (repair policy)", 15, ""),
    "faults": ({"settings": {"x": {"faults": "one_randon"}}}, "UNKNOWN_NAME (file)", 16, "one_random"),
    "an axis": (
        {"asked": [{"figure": "final", "where": {"tusk": "tidy"}, "at_least": 1}]},
        "UNKNOWN_NAME (axis)",
        17,
        "task",
    ),
    "a value": (
        {"asked": [{"figure": "final", "where": {"task": "tidi"}, "at_least": 1}]},
        "UNKNOWN_NAME (task)",
        17,
        "tidy",
    ),
    "no bound": ({"asked": [{"figure": "final"}]}, "MISSING_VALUE", 15, ""),
    "a key": ({"common": {"sens": "truth"}}, "UNKNOWN_NAME (key)", 15, "sense"),
    "an environment": ({"common": {"environment": "libero"}}, "UNKNOWN_NAME (environment)", 15, ""),
    "a file": ({"common": {"files": {"safty.yaml": {}}}}, "UNKNOWN_NAME (settings file)", 16, "safety.yaml"),
    "its value": ({"common": {"files": {"perception.yaml": {"sensing": "lies"}}}}, "INVALID_VALUE", 17, ""),
    "an override": ({"common": {"set": {"targets.arn": "panda"}}}, "UNKNOWN_NAME (role)", 0, ""),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named_where_it_stands(mistake, read):
    changes, code, line, nearest = MISTAKES[mistake]
    with pytest.raises(DefinitionError) as error:
        read(**changes)
    found = [problem for problem in error.value.problems if problem.label == code]

    assert found, error.value.problems
    assert not line or found[0].address.split(":")[1] == str(line), found[0]
    assert nearest in found[0].hint


def test_what_is_not_here_is_missing_and_says_why(read, monkeypatch, tmp_path):
    monkeypatch.setenv("PHYAGENTOS_ENVIRONMENTS", str(tmp_path))
    plan = read(
        environments={"other": {"packages": ["numpy"]}},
        settings={"here": {}, "there": {"environment": "other"}, "module": {"needs": ["no_such_module"]}},
        policies={"own": {}, "served": {"ready": "127.0.0.1:9"}, "begun": {"serve": ["no-such-program"]}},
        seeds=[0],
    )
    codes = {id: [problem.label for problem in problems] for id, problems in plan.missing.items()}

    assert "tidy.own.here.0" not in codes
    assert codes["tidy.own.there.0"] == ["EXTRA_MISSING"]
    assert codes["tidy.own.module.0"] == ["EXTRA_MISSING"]
    assert codes["tidy.served.here.0"] == codes["tidy.begun.here.0"] == ["POLICY_UNREACHABLE"]
    assert "paos bench setup other" in str(plan.missing["tidy.own.there.0"][0])


def test_a_program_that_paos_does_not_install_is_missing_with_what_installs_it(tmp_path):
    program = tmp_path / "server"
    spec = EnvironmentSpec(files=(str(program),), about="apt-get install server")
    (lack,) = find_lacks("game", spec)
    assert (lack.code, lack.address, lack.hint) == ("EXTRA_MISSING", str(program), "apt-get install server")
    assert plan_setup("game", spec) == []
    program.touch()
    assert find_lacks("game", spec) == []


def test_an_environment_lacks_what_it_does_not_hold(monkeypatch, tmp_path):
    import sys

    monkeypatch.setenv("PHYAGENTOS_ENVIRONMENTS", str(tmp_path))
    python = tmp_path / "this" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    python.chmod(0o755)
    whole = EnvironmentSpec(packages=("numpy>=1", "pyyaml"), imports=("yaml",))
    lacking = EnvironmentSpec(packages=("numpy<1", "no-such-package"), imports=("no_such_module",))

    assert find_lacks("this", whole) == []
    assert [problem.expected for problem in find_lacks("this", lacking)] == [
        "numpy<1",
        "no-such-package",
        "module no_such_module",
    ]
    assert [command[1:4] for command in plan_setup("new", whole)] == [
        ["-m", "venv", str(tmp_path / "new")],
        ["-m", "pip", "install"],
    ]


def make_record(id="a.1", **facts):
    return EpisodeRecord(**{"id": id, "task": "a", "seed": 1, "at": "", "folder": "", "verdict": "success", **facts})


def test_the_log_keeps_a_record_once_and_drops_a_half_line(tmp_path):
    with contextlib.closing(EpisodeLog(tmp_path)) as log:
        assert (log.append(make_record()), log.append(make_record(verdict="failure"))) == (True, False)
    with (tmp_path / "episodes.jsonl").open("ab") as file:
        file.write(b'{"id":"a.2"')
    with contextlib.closing(EpisodeLog(tmp_path)) as log:
        assert log.append(make_record("a.3", seed=3))
    assert [record.id for record in read_records(tmp_path)] == ["a.1", "a.3"]
    os.truncate(tmp_path / LOG, 1 << 40)
    with pytest.raises(DefinitionError, match=r"episodes\.jsonl: TOO_LARGE"):
        read_records(tmp_path)


def test_a_line_that_stands_twice_counts_once_and_no_record_or_two_of_an_episode_are_refused(tmp_path):
    line = lambda id, **facts: msgspec.json.encode(make_record(id, **facts)) + b"\n"  # noqa: E731
    lines = [line(id) for id in ("a.1", "a.2", "a.1")]
    (tmp_path / "episodes.jsonl").write_bytes(b"".join(lines))
    assert [record.id for record in read_records(tmp_path)] == ["a.1", "a.2"]
    for wrong, number in (([*lines, line("a.2", verdict="failure")], 4), ([b"{}\n"], 1)):
        (tmp_path / "episodes.jsonl").write_bytes(b"".join(wrong))
        with pytest.raises(DefinitionError, match=rf"episodes\.jsonl:{number}: CHANGED"):
            read_records(tmp_path)


def test_a_gap_in_the_second_run_is_a_regression():
    runs = [[make_record(f"a.{seed}", seed=seed, is_met=True) for seed in seeds] for seeds in (range(4), range(3))]

    assert compare(*runs).is_regression()
    assert not compare(runs[1], runs[0]).is_regression()
    with pytest.raises(DefinitionError, match="INVALID_VALUE"):
        compare(runs[0], [make_record("b.9", seed=9)])


MOODY = """#!/bin/sh
case $3 in
  *tidy.1-1) exec sleep 600;;
  *) echo fell over; exit 7;;
esac
"""


@pytest.fixture
def moody(tmp_path, monkeypatch):
    """Episodes run in `MOODY`: no server that another test has begun forks them."""
    (tmp_path / "moody").write_text(MOODY)
    (tmp_path / "moody").chmod(0o755)
    monkeypatch.setattr("phyagentos.bench.episode.sys.executable", str(tmp_path / "moody"))
    monkeypatch.delenv(ADDRESS, raising=False)


@pytest.mark.slow
@pytest.mark.usefixtures("moody")
def test_an_episode_that_found_no_room_on_its_disk_is_no_result_and_is_carried_out_again(read, tmp_path, monkeypatch):
    plan = read(seeds=[0, 2], wall_s=5.0)
    monkeypatch.setattr("phyagentos.bench.episode.has_room", lambda folder: False)
    manifest = begin_run(tmp_path / "r", tmp_path / "suite.yaml", plan, SystemClock())
    with pytest.raises(ExecutionError, match=r"no room is left on its disk, .* paos bench resume"):
        list(run_sweep(tmp_path / "r", manifest, open_engine(EngineName.LOCAL, 1), {}, SystemClock()))
    assert read_records(tmp_path / "r") == []


@pytest.mark.slow
@pytest.mark.usefixtures("moody")
def test_an_episode_that_dies_or_hangs_has_its_record_and_the_rest_goes_on(read, tmp_path, monkeypatch):
    plan = read(seeds=[0, 1, 2], wall_s=1.0)
    monkeypatch.setattr("phyagentos.bench.episode.START_S", 0.0)
    manifest = begin_run(tmp_path / "r", tmp_path / "suite.yaml", plan, SystemClock())
    records = list(run_sweep(tmp_path / "r", manifest, open_engine(EngineName.LOCAL, 1), {}, SystemClock()))

    assert [(record.seed, record.ended) for record in records] == [(0, "crashed"), (1, "hung"), (2, "crashed")]
    assert records[0].error == "exit code 7: fell over"
    assert [record.taxon for record in records] == ["execution", "timeout", "execution"]


def test_a_comparison_is_paired_by_seed_and_ends_with_1_on_a_regression(read, paos, tmp_path):
    plan = read(settings={"plain": {}, "spoilt": {}}, seeds={"count": 6})
    begin_run(tmp_path / "r", tmp_path / "suite.yaml", plan, SystemClock())
    log = EpisodeLog(tmp_path / "r")
    for order in plan.orders:
        facts = {"task": order.task, "setting": order.setting, "seed": order.seed}
        log.append(make_record(order.id, is_met=order.setting == "plain", **facts))
    log.close()

    worse = paos("bench", "compare", "r:setting=plain", "r:setting=spoilt")
    assert (worse.code, "gained 0, lost 6, p = 0.03125" in worse.out) == (1, True)
    assert paos("bench", "compare", "r:setting=spoilt", "r:setting=plain").code == 0
    wrong = paos("bench", "compare", "r:settings=plain", "r")
    assert (wrong.code, "UNKNOWN_NAME" in wrong.err) == (2, True)


@pytest.mark.parametrize(
    ("figure", "part", "value"),
    [
        ("final", "", 2 / 3),
        ("first", "", 1 / 3),
        ("parts", "", 5 / 6),
        ("first_parts", "", 0.5),
        ("parts", "y", 2 / 3),
        ("false_successes", "", 1.0),
        ("false_failures", "", 1.0),
    ],
)
def test_figures_are_those_of_the_records(figure, part, value):
    records = [
        make_record("a.1", is_met=True, parts={"x": True, "y": True}, first_parts={"x": True}),
        make_record("a.2", seed=2, is_met=False, replans=1, parts={"x": True, "y": False}, first_parts={"x": False}),
        make_record("a.3", seed=3, is_met=True, replans=1, verdict="failure", parts={"x": True, "y": True}),
    ]
    assert compute_figure(FigureThreshold(figure=figure, **({"part": part} if part else {})), records) == value


def test_the_same_failure_again_counts_the_chances_to_and_retention_goes_seed_by_seed():
    def miss(cause):
        return SessionRecord(
            id="g.n",
            node="n",
            attempt=0,
            skill="s",
            target="t",
            objective="",
            state="failed",
            cause=cause,
            bundle="",
            taxon="execution",
        )

    lost, slipped = miss("GRASP_MISSED"), miss("GRASP_LOST")
    records = [
        make_record("a.1", phase="x", is_met=True, replans=1, sessions=(lost,)),
        make_record("a.2", phase="x", seed=2, is_met=True, sessions=(lost, slipped)),
        make_record("a.3", phase="y", is_met=True),
        make_record("a.4", phase="y", setting="other", is_met=False, sessions=(lost,)),
        make_record("b.1", phase="y", task="b", is_met=False, sessions=(lost,)),
    ]

    counted = {id: (rate.successes, rate.trials) for id, rate in count_repeats(records).items()}
    assert counted == {"a.1": (0, 0), "a.2": (1, 1), "a.3": (0, 2), "a.4": (0, 0), "b.1": (0, 0)}
    assert follow_seeds(records) == {"all": {"x": (0.0, 1.0), "y": (0.5,)}, "other": {"y": (0.0,)}}


def test_what_is_held_constant_has_one_hash_and_the_rest_says_what_it_has_alone():
    def hold(task, targets):
        held = {"planner": Held(hash="p"), "targets": Held(hash=targets[-1], says=targets)}
        return make_record(f"{task}.1", task=task, held=held)

    planner, targets = compare_held([hold("a", ("floor", "arm")), hold("b", ("floor", "agent"))])
    assert (planner.part, planner.is_constant) == ("planner", True)
    assert (targets.is_constant, targets.own) == (False, {"a": ("arm",), "b": ("agent",)})


def test_every_cause_of_a_verdict_has_a_kind_of_failure():
    kinds = {cause: classify_cause(cause) for cause in Cause}
    assert set(kinds.values()) == set(Taxon)
    assert (kinds[Cause.OBJECT_HIDDEN], kinds[Cause.GRASP_MISSED]) == (Taxon.PERCEPTION, Taxon.EXECUTION)
    problems = {
        "NO_IK": Taxon.PLANNING,
        "ACTION_SPACE_MISMATCH (joints)": Taxon.ADAPTER,
        "POLICY_MISMATCH": Taxon.POLICY,
    }
    assert {label: classify_problems([Problem(label, "x")]) for label in problems} == problems


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted((make_project.__globals__["ROOT"] / "benchmarks" / "suites").glob("*.yaml")))
def test_a_suite_that_ships_compiles(path):
    plan = compile_suite(path)

    assert plan.orders
    assert json.loads(msgspec.json.encode(plan.orders[0]))["id"] == plan.orders[0].id
    assert os.fspath(path.stem) == plan.suite.suite


def test_what_an_environment_says_counts_after_the_session_asked_about_or_after_the_last_one(tmp_path):
    path = tmp_path / FILE
    path.parent.mkdir()
    lines = [
        {"session": "g.a", "success": False, "completed": ["door"]},
        {"session": "g.b", "success": True, "completed": ["door", "lamp"]},
    ]
    path.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    parts = {"a": "door", "b": "lamp", "all": "success"}

    assert OUTCOMES.score(parts, tmp_path, None) == {"a": True, "b": True, "all": True}
    assert OUTCOMES.score(parts, tmp_path, tmp_path / "evidence" / "g.a") == {"a": True, "b": False, "all": False}
    assert OUTCOMES.score(parts, tmp_path, tmp_path / "evidence" / "g.c") == {"a": False, "b": False, "all": False}


def test_a_policy_is_served_by_the_python_of_its_environment(monkeypatch, tmp_path):
    monkeypatch.setenv("PHYAGENTOS_ENVIRONMENTS", str(tmp_path))
    own = {"environment": "there", "serve": ("python", "serve.py")}

    assert Policy(**own).command == (str(tmp_path / "there" / "bin" / "python"), "serve.py")
    assert Policy(**{**own, "serve": ("other", "serve.py")}).command == ("other", "serve.py")
    assert Policy(serve=("python", "serve.py")).command == ("python", "serve.py")
