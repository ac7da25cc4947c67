"""Nodes of BehaviorTree.CPP and Nav2 in nodes of this project: what has an equal is written so, the rest is explained.

An equal gives the same result for every result of its children. `Timeout`, `Delay` and `Sleep` count simulated time.
https://www.behaviortree.dev/docs/learn-the-basics/bt_basics
"""

from collections.abc import Callable
from dataclasses import replace

from phyagentos.export.bt_xml_elements import Element

MS_PER_S = 1000.0
_SUCCEEDS, _FAILS = "wait", "fail"  # leaves: at once, the first without seconds
EXPLAINED = {  # tag: what is written instead
    "AsyncFallback": "Write <Fallback>.",
    "AsyncSequence": "Write <Sequence>.",
    "DistanceController": "There is no equal; 'cooldown' spaces attempts by time.",
    "GoalUpdatedController": "There is no equal; a new goal is a new session.",
    "GoalUpdater": "There is no equal; a new goal is a new session.",
    "IfThenElse": "Nearest: a Fallback of a Sequence (condition, then) and the other branch.",
    "KeepRunningUntilFailure": 'Nearest: <Repeat num_cycles="N">, which ends.',
    "ManualSelector": "Write <Fallback>.",
    "NonblockingSequence": 'Nearest: <parallel policy="all">.',
    "ParallelAll": 'Nearest: <parallel policy="all">, which ends at the first failure.',
    "PathLongerOnApproach": "There is no equal; write a <condition> in a ReactiveFallback.",
    "PauseResumeController": "There is no equal; a person pauses with `paos pause`.",
    "PipelineSequence": "Nearest: <ReactiveSequence>, of which one child takes time.",
    "Precondition": "Write a Sequence of a <condition> and the child.",
    "RateController": "There is no equal; 'cooldown' spaces attempts by time.",
    "RecoveryNode": "Nearest: <RetryUntilSuccessful> of a Fallback: the child, then a Sequence (recovery, <fail>).",
    "RoundRobin": "Nearest: <Fallback>, which begins at its first child.",
    "RunOnce": "There is no equal; put the child before what is repeated.",
    "Script": "There is no equal; values come from ports of leaves and from inputs of the tree.",
    "ScriptCondition": "Write a <condition> with a predicate.",
    "SequenceStar": "Nearest: <Sequence>, which begins at its first child after a failure.",
    "SequenceWithMemory": "Nearest: <Sequence>, which begins at its first child after a failure.",
    "SetBlackboard": "There is no equal; values come from ports of leaves and from inputs of the tree.",
    "SingleTrigger": "There is no equal; put the child before what is repeated.",
    "SpeedController": "There is no equal; 'cooldown' spaces attempts by time.",
    "SubTreePlus": "Write <SubTree>, with each port wired.",
    "UnsetBlackboard": "There is no equal; a key has a value until the tree ends.",
    "WhileDoElse": "Nearest: a ReactiveFallback of a ReactiveSequence (condition, do) and the other branch.",
}
FAMILIES = {  # begin of a tag
    "BlackboardCheck": "Write a Sequence of a <condition> and the child.",
    "ForEach": "Write <for_each>, whose list is a port.",
    "Loop": "Write <for_each>, whose list is a port.",
    "Switch": "Write a Fallback of Sequences (condition, case), the default last.",
}
_DECORATORS = {"Delay", "ForceFailure", "ForceSuccess"}  # whose equals hold several
_PARALLEL = {"success_count", "failure_count", "success_threshold", "failure_threshold"}


def find_equal(element: Element) -> tuple[Element, str]:
    """The element as nodes of this project, the same one where it is one; and what keeps it from being written so."""
    make = _EQUALS.get(element.tag)
    if make is None:
        return element, ""
    if element.tag in _DECORATORS and len(element.children) != 1:
        return make(element)[0], f"<{element.tag}> with {len(element.children)} nodes in it; expected one"
    return make(element)


def explain(tag: str) -> str:
    """What is written instead of a node that holds others and has no equal."""
    families = (hint for begin, hint in FAMILIES.items() if tag.startswith(begin))
    return EXPLAINED.get(tag) or next(families, "")


def _time(own: str, tag: str) -> Callable[[Element], tuple[Element, str]]:
    """A node that counts milliseconds, by its attribute and our tag."""

    def make(element: Element) -> tuple[Element, str]:
        text = element.attributes.get(own, "")
        seconds = str(float(text) / MS_PER_S) if text.isdigit() else "1"
        rest = {key: value for key, value in element.attributes.items() if key != own}
        name, more = {"name": rest.pop("name")} if "name" in rest else {}, {"seconds": seconds}
        problem = "" if text.isdigit() else f"<{element.tag} {own}={text!r}>; expected a number of milliseconds"
        if tag != "Sequence":
            return replace(element, tag=tag, attributes=name | more | rest), problem
        wait = replace(element, tag=_SUCCEEDS, attributes=more, children=[])
        return replace(element, tag=tag, attributes=name | rest, children=[wait, *element.children]), problem

    return make


def _force(tag: str, last: str) -> Callable[[Element], tuple[Element, str]]:
    """A decorator that answers the same whatever its child does: the child in a composite, and a leaf after it."""

    def make(element: Element) -> tuple[Element, str]:
        leaf = _answer(last)(replace(element, attributes={}, children=[]))[0]
        return replace(element, tag=tag, children=[*element.children, leaf]), ""

    return make


def _answer(leaf: str) -> Callable[[Element], tuple[Element, str]]:
    more = {"seconds": "0"} if leaf == _SUCCEEDS else {"code": "UNMET"}
    return lambda element: (replace(element, tag=leaf, attributes=element.attributes | more), "")


def _make_parallel(element: Element) -> tuple[Element, str]:
    """Ours succeeds when all or one of the children does, and fails with the first that fails."""
    given = {key: element.attributes[key] for key in _PARALLEL & element.attributes.keys()}
    counts = {key.partition("_")[0]: text for key, text in given.items()}
    every = {"-1", str(len(element.children))}
    policy = {"1": "one"}.get(counts.get("success", "-1"), "all" if counts.get("success", "-1") in every else "")
    problem = ""
    if not policy or counts.get("failure", "1") != "1":
        shown = " ".join(f'{key}="{text}"' for key, text in given.items())
        problem = f"<{element.tag} {shown}>; expected all or 1 to succeed, and failure with the first failure"
    rest = {key: value for key, value in element.attributes.items() if key not in given}
    return replace(element, tag="parallel", attributes=rest | {"policy": policy or "all"}), problem


def _rename(tag: str) -> Callable[[Element], tuple[Element, str]]:
    return lambda element: (replace(element, tag=tag), "")


_EQUALS: dict[str, Callable[[Element], tuple[Element, str]]] = {
    "AlwaysFailure": _answer(_FAILS),
    "AlwaysSuccess": _answer(_SUCCEEDS),
    "Delay": _time("delay_msec", "Sequence"),
    "ForceFailure": _force("Sequence", _FAILS),
    "ForceSuccess": _force("Fallback", _SUCCEEDS),
    "Parallel": _make_parallel,
    "RetryUntilSuccesful": _rename("RetryUntilSuccessful"),  # as version 3 spelt it
    "Sleep": _time("msec", "wait"),
    "Timeout": _time("msec", "timeout"),
}
