"""An agent directs a session: each call is checked, budgeted and traced; its claims decide nothing."""

import dataclasses
import json
import threading

import pytest
from msgspec.structs import replace

from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.skill_runtimes import AgentLoop, SkillRuntime, read_skill
from phyagentos.protocol.sessions import agent_calls
from phyagentos.protocol.sessions.agent_calls import CallFiles, Turn
from phyagentos.protocol.sessions.evidence import TRACE
from phyagentos.protocol.sessions.session import Ended, Limits
from phyagentos.runtime.execution.loop import EndRequest

PUT = {"call": "invoke_tool", "tool": "pick_and_place"}
RIGHT = {"object": "red_cube", "destination": "red_tray"}
FINISH = {"call": "finish"}


@pytest.fixture
def direct(build_bench, build_session, library, tmp_path):
    """Runs a session that calls of a list, or of an outside agent, direct; the execution, and what the agent did."""

    def run(*calls, max_calls=8, limits=None, cancel=lambda: None, tools=("home", "pick_and_place")):
        bench = build_bench(clock=SystemClock() if not calls else None)
        skills = {name: read_skill(library.get_skill(name))[0] for name in ("home", "pick_and_place", "push")}
        loop = AgentLoop(tools=tools, calls=max_calls, procedure=calls)
        skills["find"] = SkillRuntime(skill="find", description="Find.", kind="agent_loop", loop=loop)
        loops = {"skills": skills, "loops": tmp_path / "loops", "clock": bench.clock}
        bench.runner._skills = dataclasses.replace(bench.runner._skills, **loops)
        session = build_session(skill="find", parameters={}, limits=limits or Limits())
        execution = bench.run(session, cancel=cancel, plan={"agent_tools": list(tools)})
        lines = (tmp_path / execution.evidence / TRACE).read_text().splitlines()
        return execution, [json.loads(line) for line in lines]

    return run


def list_codes(trace):
    return [event["code"] for event in trace if event["path"] == "agent" and event["status"] == "FAILURE"]


def test_a_procedure_goes_through_its_steps_and_every_call_is_traced(direct):
    execution, trace = direct(
        {"call": "observe"}, {"call": "invoke_tool", "tool": "home"}, {"call": "wait", "seconds": 1.0}
    )
    assert execution.ended is Ended.COMPLETED
    calls = [event["numbers"]["call"]["call"] for event in trace if event["path"] == "agent"]
    assert calls == ["observe", "invoke_tool", "wait", "finish"]
    assert any(event["path"].startswith("home") for event in trace)
    assert execution.sim_time_s >= 1.0
    ticks = [event["tick"] for event in trace]
    assert ticks == sorted(ticks)


@pytest.mark.parametrize(
    ("call", "code"),
    [
        ({"call": "invoke_tool", "tool": "push"}, "UNKNOWN_NAME"),
        ({"call": "invoke_tool", "tool": "../home"}, "UNKNOWN_NAME"),
        (PUT | {"arguments": {"object": "red_cube"}}, "MISSING_VALUE"),
        (PUT | {"arguments": RIGHT | {"speed": 9}}, "UNKNOWN_NAME"),
        (PUT | {"arguments": RIGHT | {"near": "here"}}, "INVALID_VALUE"),
        (PUT | {"arguments": RIGHT | {"object": "gold"}}, "NOT_OBSERVED"),
        ({"call": "query_state", "predicate": "os.system('x')"}, "SYNTAX"),
    ],
)
def test_a_call_that_does_not_fit_is_refused_and_moves_nothing(direct, call, code):
    execution, trace = direct(call)
    assert list_codes(trace) == [code]
    assert (execution.ended, execution.ticks) == (Ended.COMPLETED, 0)


def test_an_agent_that_does_not_finish_has_so_many_calls(direct):
    execution, _ = direct(*[{"call": "observe"}] * 9, max_calls=3)
    assert (execution.ended, execution.code) == (Ended.SKILL_FAILED, "BUDGET")


def test_an_agent_may_give_up(direct):
    execution, _ = direct({"call": "finish", "claim": "failure", "reason": "no such cube"})
    assert (execution.code, execution.message) == ("AGENT_GAVE_UP", "no such cube")


def test_the_time_of_the_contract_is_that_of_the_agent(direct):
    execution, _ = direct(*[{"call": "wait", "seconds": 30.0}] * 3, limits=Limits(timeout_s=2.0))
    assert execution.ended is Ended.TIMED_OUT
    assert execution.sim_time_s == pytest.approx(2.0, abs=0.5)


def test_a_tool_is_cancelled_like_any_session(direct):
    turns = iter(range(30))
    execution, _ = direct(
        {"call": "wait", "seconds": 60.0},
        cancel=lambda: None if next(turns, None) is not None else EndRequest("cancelled"),
    )
    assert execution.ended is Ended.CANCELLED
    assert execution.ticks < 31


def test_steps_are_passed_over_where_their_condition_is_not_true(direct):
    home = {"call": "invoke_tool", "tool": "home"}
    _, trace = direct(home | {"when": "inside(red_cube, red_tray)"}, {"call": "observe", "when": "visible(red_cube)"})
    assert [event["numbers"]["call"]["call"] for event in trace if event["path"] == "agent"] == ["observe", "finish"]


def test_an_outside_agent_sees_turns_and_answers_each_once(direct, tmp_path):
    files, seen = CallFiles(tmp_path / "loops" / "tidy-1.red"), []

    def talk():
        calls = [
            {"call": "observe"},
            {"call": "query_state", "predicate": "visible(red_cube)"},
            {"call": "fly"},
            {"call": "invoke_tool", "tool": "home"},
            FINISH,
        ]
        for number, call in enumerate(calls, 1):
            while (turn := files.find_turn()) is None or turn.turn != number:
                SystemClock().sleep(0.005)
            seen.append(turn)
            files.answer(number, call)

    agent = threading.Thread(target=talk)
    agent.start()
    execution, _ = direct()
    agent.join()
    assert execution.ended is Ended.COMPLETED
    assert [tool["name"] for tool in seen[0].tools] == ["home", "pick_and_place"]
    assert [turn.calls_left for turn in seen] == [8, 7, 6, 5, 4]
    assert "red_cube" in seen[1].result["world"]["things"]
    assert seen[2].result == {"ended": "done", "truth": "true", "because": seen[2].result["because"]}
    assert seen[3].result["problems"][0]["code"] == "INVALID_VALUE"
    assert seen[4].result == {"ended": "done", "outputs": {}}
    with pytest.raises(DefinitionError, match="ALREADY_OVER"):
        files.answer(5, FINISH)


@pytest.fixture
def files(tmp_path):
    shown = CallFiles(tmp_path / "loops" / "s")
    turn = Turn(turn=1, objective="", accept=(), calls_left=2, time_s=0.0, tools=())
    shown.show(turn)
    return shown, turn


def test_an_answer_that_comes_while_it_is_looked_for_is_found_next_time(files, monkeypatch):
    shown, _ = files

    def look_too_early(*_, **__):
        monkeypatch.undo()
        shown.answer(1, FINISH)
        raise FileNotFoundError

    monkeypatch.setattr(agent_calls, "read_regular", look_too_early)
    assert shown.find_answer(1) is None
    assert shown.find_answer(1) == FINISH


def test_only_the_open_turn_can_be_answered(files):
    shown, turn = files
    for number in (0, 2, -1):
        with pytest.raises(DefinitionError, match="ALREADY_OVER"):
            shown.answer(number, FINISH)
    shown.answer(1, FINISH)
    with pytest.raises(DefinitionError, match="ALREADY_OVER"):
        shown.answer(1, {"call": "observe"})
    assert shown.find_answer(1) == FINISH
    shown.show(replace(turn, turn=2))
    assert shown.find_answer(2) is None


@pytest.mark.parametrize("data", [b"", b"\xff", b"[" * 100_000, b"{" + b" " * (1 << 17) + b"}"])
def test_what_is_no_answer_is_an_empty_one(files, tmp_path, data):
    shown, _ = files
    (tmp_path / "loops" / "s" / "answer-0001.json").write_bytes(data)
    assert shown.find_answer(1) == {}


def test_a_link_is_no_answer(files, tmp_path):
    shown, _ = files
    (tmp_path / "elsewhere.json").write_text('{"call": "finish"}')
    (tmp_path / "loops" / "s" / "answer-0001.json").symlink_to(tmp_path / "elsewhere.json")
    assert shown.find_answer(1) == {}
