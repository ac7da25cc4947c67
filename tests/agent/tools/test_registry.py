"""Tools are declared, checked before they run, offered up to a level, and every call is recorded."""

from dataclasses import replace

import pytest

from phyagentos.agent.tools.registry import Answer, Level, Tool, ToolRegistry
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.testing import ManualClock


def greet(name: str, times: int = 1) -> Answer:
    """Greets
    a name."""
    if name == "lost":
        raise ExecutionError("TARGET_LOST", "it is gone")
    return Answer({"said": [name] * times})


def declare(name, level=Level.READ, **more):
    return replace(Tool.of(greet, level, **more), name=name)


@pytest.fixture
def calls():
    return []


@pytest.fixture
def make(calls):
    def make(level=Level.READ):
        tools = [
            declare("read"),
            declare("propose", Level.PROPOSE),
            declare("submit", Level.SUBMIT),
            declare("halt", Level.READ, is_stop=True, is_destructive=True),
        ]
        return ToolRegistry(tools, level, clock=ManualClock(), record=calls.append)

    return make


def refuse(registry, name, arguments):
    with pytest.raises(DefinitionError) as refused:
        registry.call(name, arguments)
    return refused.value.problems[0]


@pytest.mark.parametrize(
    ("level", "offered"),
    [
        (Level.READ, ["read", "halt"]),
        (Level.PROPOSE, ["read", "propose", "halt"]),
        (Level.SUBMIT, ["read", "propose", "submit", "halt"]),
    ],
)
def test_a_level_offers_what_is_below_it_and_stops_always(make, level, offered):
    assert [tool.name for tool in make(level).list_offered()] == offered


def test_a_tool_above_the_level_is_refused_and_never_called(make, calls):
    problem = refuse(make(), "submit", {"name": "x"})
    assert problem.code == "NOT_PERMITTED"
    assert "--level submit" in problem.hint
    assert [(call.tool, call.code) for call in calls] == [("submit", "NOT_PERMITTED")]


def test_an_unknown_tool_is_refused_with_those_that_there_are(make):
    problem = refuse(make(), "raed", {})
    assert (problem.label, problem.hint) == ("UNKNOWN_NAME (tool)", "Did you mean 'read'?")


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        ({"name": 7}, "INVALID_VALUE"),
        ({"name": "a", "times": "2"}, "INVALID_VALUE"),
        ({"name": "a", "times": True}, "INVALID_VALUE"),
        ({}, "MISSING_VALUE"),
        ({"name": "a", "level": "submit"}, "UNKNOWN_NAME (key)"),
        (["a"], "INVALID_VALUE"),
        ({"name": "\ud800"}, "INVALID_VALUE"),
        ({"name": "a" * (1 << 20)}, "TOO_LARGE"),
        ({"name": b"a", "times": {1: object()}}, "INVALID_VALUE"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(make, arguments, code):
    assert refuse(make(), "read", arguments).label == code


def test_an_answer_and_a_failure_are_recorded(make, calls):
    registry = make()
    assert registry.call("read", {"name": "you", "times": 2}).facts == {"said": ["you", "you"]}
    with pytest.raises(ExecutionError):
        registry.call("read", {"name": "lost"})
    with pytest.raises(OverflowError):
        registry.call("read", {"name": "a", "times": 10**30})
    assert [call.code for call in calls] == ["", "TARGET_LOST", "OverflowError"]
    assert calls[0].arguments == {"name": "you", "times": 2}


def test_the_record_of_a_call_stays_short(make, calls):
    make().call("read", {"name": "a" * 100_000})
    assert calls[0].arguments == "100011 bytes"


def test_a_function_declares_its_tool():
    tool = Tool.of(greet)
    assert (tool.name, tool.description) == ("greet", "Greets a name.")
    assert tool.arguments.model_json_schema()["required"] == ["name"]
    assert tool.arguments.model_json_schema()["additionalProperties"] is False


def test_a_stop_may_pass_over_what_it_does_not_know(calls):
    stop = declare("stop", is_stop=True)
    registry = ToolRegistry([stop], Level.READ, clock=ManualClock(), record=calls.append)
    assert registry.call("stop", {"name": "a", "now": True}).facts == {"said": ["a"]}
