"""A benchmark's agent is that of `paos run`: every setting of verifier and memory is changed, and acts through it.

The goal lifts the mark of a counter to a height that takes three sessions; what is asked of one session alone is met by
none, so each setting shows in what follows for it.
"""

import ast
import os
import shutil
from pathlib import Path

import pytest
import yaml

from phyagentos.agent.memory.memory import Memory
from phyagentos.assembly.agent_plane import MemoryUse, open_agent
from phyagentos.assembly.paths import open_project
from phyagentos.assembly.planes import start_watch
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.memory_entries import Embodiment
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY
from phyagentos.protocol.sessions.verdicts import Verdict
from phyagentos.protocol.settings.verification import Verification
from phyagentos.protocol.settings.verification_mode import VerificationMode
from tests.agent.memory.conftest import SLOW, make_episode
from tests.agent.test_judge_registry import HASTE
from tests.packages import install

ROOT = Path(__file__).resolve().parents[2]
CLOCK = SystemClock()
GOAL = """
goal: lift
objective: Three steps up.
scene: counter
targets: {slide: counter}
defaults: {max_replans: 2}
sessions:
  high:
    skill: advance
    target: slide
    with: {object: mark, destination: mark}
    accept: ["height(mark) >= 0.045"]
accept: ["height(mark) >= 0.045"]
"""
PARAMETERS = "parameters: {object: {type: entity, description: x.}, destination: {type: entity, description: x.}}\n"
TREE = "tree: advance\ndescription: Ten steps.\nroot: {sequence: {children: [" + "advance_one_step, " * 10 + "]}}\n"
NOWHERE = {"url": "http://127.0.0.1:9/v1", "model": "looker", "timeout_s": 0.2}

pytestmark = pytest.mark.journey


def copy_library(folder):
    """The counter's, with a skill that names an object and a place, as experience does."""
    shutil.copytree(ROOT / "benchmarks" / "library", folder)
    skill = folder / "skills" / "advance" / "SKILL.md"
    text = skill.read_text().replace("tree: advance\n", f"tree: advance\n{PARAMETERS}")
    skill.write_text(text.replace('"moved(mark)"', '"moved(mark)", "near(${object}, ${destination}, 1)"'))
    return folder


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    """A workspace with a warm runtime plane; settings of the agent are read when an agent is opened."""
    base = tmp_path_factory.mktemp("one_path")
    workspace = open_project(base / "w", copy_library(base / "library"))
    (workspace.root / "lift.yaml").write_text(GOAL)
    with pytest.MonkeyPatch.context() as patch:
        install(base / "site", "haste_judge", HASTE, {"phyagentos.judges": {"haste": "haste_judge:HASTE"}})
        patch.syspath_prepend(base / "site")
        patch.setenv("PYTHONPATH", str(base / "site"), prepend=os.pathsep)
        with start_watch(workspace, pictures=False).running(CLOCK):
            yield workspace


def declare(workspace, **settings):
    data = yaml.safe_load(workspace.runtime_contract.read_text())
    workspace.runtime_contract.write_text(yaml.safe_dump({**data, **settings}))


@pytest.fixture
def pursue(watched, request):
    """Runs the goal with an agent of its own; the report, and the session statuses."""
    before = watched.runtime_contract.read_text()

    def run(verification=None, **options):
        if verification is not None:
            declare(watched, verification=verification)
        with open_agent(watched, CLOCK, by="bench", **options) as agent:
            report = agent.mission.run(watched.root / "lift.yaml", seed=0)
            return report, [agent.mission.ledger.sessions[session.id] for session in report.sessions]

    yield run
    watched.runtime_contract.write_text(before)


def check_mode(pursue):
    expected = {
        VerificationMode.OFF: ("unverified", 1),
        VerificationMode.AUDIT: ("failure", 1),
        VerificationMode.ENFORCE: ("failure", 1),
        VerificationMode.RECOVERY: ("success", 3),
    }
    found, first = {}, {}
    for mode in VerificationMode:
        report, statuses = pursue({"mode": mode.value})
        found[mode], first[mode] = (report.verdict, len(statuses)), statuses[0].decision.verdict
    assert found == expected
    assert first[VerificationMode.AUDIT] == Verdict.SUCCESS, "the execution completed, and that decides"
    assert first[VerificationMode.ENFORCE] == Verdict.FAILURE
    report, _ = pursue({"mode": "off"}, verify=VerificationMode.RECOVERY)
    assert report.verdict == "success", "--verify goes before the settings"


def check_judges(pursue):
    _, statuses = pursue({"judges": ["predicates"]})
    assert statuses[0].decision.judges == ("predicates/2",)
    _, statuses = pursue({})
    assert len(statuses[0].decision.judges) > 1


def check_criteria(pursue):
    report, statuses = pursue({"criteria": ["metric(ticks) <= 0"]})
    assert report.verdict == "failure"
    assert "metric(ticks) <= 0" in {each.text for each in statuses[-1].decision.criteria}


def check_vision(pursue):
    _, statuses = pursue({"judges": ["predicates", "vision"], "vision": NOWHERE})
    assert [each for each in statuses[-1].decision.judges if each.startswith("vision")]


def check_options(pursue):
    _, statuses = pursue({"judges": ["predicates", "haste"], "options": {"haste": {"ticks_max": 7.0}}})
    assert statuses[0].decision.judges == ("predicates/2", "haste/1(7)")


CHECKS = {name.removeprefix("check_"): check for name, check in list(globals().items()) if name.startswith("check_")}


def test_every_setting_of_the_verifier_has_its_check():
    assert set(CHECKS) == set(Verification.model_fields)


@pytest.mark.parametrize("setting", CHECKS)
def test_a_setting_of_the_verifier_acts_on_the_path_of_benchmarks(setting, pursue):
    CHECKS[setting](pursue)


def test_memory_is_left_alone_or_read_or_grows(pursue, tmp_path):
    memory = Memory(tmp_path / "memory", clock=CLOCK, by="another workspace")
    body = Embodiment(kind="slide", grip_width_m=0.1, grip_force_n=0.0, control_period_s=0.02)
    case = {"item": "mark", "place": "mark", "scene": "counter", "skill": "advance", "target": "counter", "body": body}
    failed = make_episode(ok=False, **case)
    memory.record([failed, make_episode(parent=failed, strategy=SLOW, skill="advance")])

    def count_records():
        return sum(path.stat().st_size for path in (tmp_path / "memory").rglob("*.md"))

    def measure(use):
        before = count_records()
        _, statuses = pursue(memory=tmp_path, memory_use=use)
        return statuses[0].contract.strategy, bool(statuses[0].contract.advised_by), count_records() > before

    assert measure(MemoryUse.NONE) == (DEFAULT_STRATEGY, False, False)
    assert measure(MemoryUse.READ) == (SLOW, True, False)
    assert measure(MemoryUse.LEARN) == (SLOW, True, True)


def test_hold_conditions_are_sampled_as_often_as_the_settings_say(tmp_path):
    library = copy_library(tmp_path / "library")
    (library / "trees" / "advance.yaml").write_text(TREE)
    ticks = {}
    for hz in (10, 50):
        workspace = open_project(tmp_path / str(hz), library)
        declare(workspace, sampling_hz=hz)
        graph = workspace.root / "rise.yaml"
        graph.write_text(f"{GOAL}constraints: ['height(mark) <= 0.05']\n")
        with open_bench(workspace, CLOCK) as agent:
            ticks[hz] = agent.mission.run(graph, seed=0, overrides={"defaults.max_replans": "0"}).sessions[0].ticks

    assert ticks == {10: 5, 50: 4}, "the fourth step is too high, and is noticed at the next sample"


def test_no_other_place_builds_a_mission():
    files = [path for folder in ("phyagentos", "benchmarks") for path in (ROOT / folder).rglob("*.py")]
    assert {path.name for path in files if calls(path, "Mission")} == {"agent_plane.py"}
    assert not [path for path in files if "benchmarks" in path.parts and calls(path, "SessionVerifier")]


def calls(path, name):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return any(isinstance(node, ast.Call) and ast.unparse(node.func) == name for node in ast.walk(tree))
