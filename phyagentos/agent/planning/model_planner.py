"""The engine that asks a language model for a plan; every step is checked against the same problem as of any engine.

The model sees the goal, what is true now and the operators, as text of a context, and answers with names of operators.
It is shown the operators that can matter to the goal, and of each what can. What a step lacks, an overfull place or a
stage that is not reached goes back to it; steps that a plan does not need, and those after the goal, are left out. What
it cannot name cannot be done.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import pydantic

from phyagentos.agent.context.context import Section
from phyagentos.agent.context.dialogue import (
    LanguageModel,
    build_list,
    build_object,
    build_response_format,
    read_object,
)
from phyagentos.agent.planning.problem import (
    Condition,
    Fact,
    Operator,
    Plan,
    PlanningProblem,
    iter_states,
    keep_relevant,
)
from phyagentos.protocol.documents.schema import Authored

STEPS_MAX = 12
_INSTRUCTION = (
    'You plan for a robot. Answer with one JSON object, {"steps": [...]}: names of actions from the section skills, in '
    "their order, as few as the goal needs. An action can be done once all that it requires is true."
)


class ModelPlan(Authored):
    """What a model answers: names of operators."""

    steps: tuple[str, ...] = pydantic.Field(min_length=1, max_length=STEPS_MAX)


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelPlanner(LanguageModel):
    """Asks a model for plans.

    Attributes:
        known: Further sections that it is shown: lessons, knowledge, limits.
        refused: Problems of the last answer to each problem without a plan.
    """

    known: tuple[Section, ...] = ()
    refused: list[str] = field(default_factory=list)

    def solve(self, problem: PlanningProblem) -> Plan | None:
        """A plan that reaches the goal, or None, which proves nothing."""
        found = check_plan(problem, ())
        if isinstance(found, list):
            relevant = keep_relevant(problem)
            names = sorted(each.name for each in relevant.operators)
            steps = build_list({"enum": names}, least=1, most=STEPS_MAX)
            form = build_response_format("plan", build_object({"steps": steps}, "steps"))
            sections = (*_describe(relevant), *self.known)
            found = self.converse(sections, _INSTRUCTION, form, lambda text: _read(text, problem))
        self.refused[:] = found if isinstance(found, list) else ()
        return None if isinstance(found, list) else shorten(problem, found)


def check_plan(problem: PlanningProblem, operators: Sequence[Operator]) -> Plan | list[str]:
    """These operators as a plan that reaches the goal stage by stage, or why they are none."""
    plan = Plan(tuple(operators), ())
    reached: list[int] = []
    for index, state in enumerate(iter_states(problem, plan)):
        if index < len(operators):
            lacks = [fact for fact, value in operators[index].requires.items() if state.get(fact, False) is not value]
            if lacks:
                return [f"step {index + 1}, {operators[index].name}, needs {_render(operators[index].requires, lacks)}"]
        for each in problem.capacities:
            if sum(weight for fact, weight in each.weights.items() if state.get(fact)) > each.most:
                return [f"after step {index}: no room in {each.place}"]
        for stage in problem.stages[len(reached) : -1]:
            if _find_unmet(stage, state):
                break
            reached.append(index)
    if len(reached) < len(problem.stages) - 1:
        return [f"never true: {text}" for text in _find_unmet(problem.stages[len(reached)], state)]
    unmet = _find_unmet(problem.stages[-1], state)
    return [f"not true at the end: {text}" for text in unmet] or Plan(plan.operators, (*reached, len(operators)))


def shorten(problem: PlanningProblem, plan: Plan) -> Plan:
    """A plan without the steps that it does not need, the later ones first."""
    for index in reversed(range(len(plan.operators))):
        shorter = check_plan(problem, (*plan.operators[:index], *plan.operators[index + 1 :]))
        plan = plan if isinstance(shorter, list) else shorter
    return plan


def _find_unmet(stage: Sequence[Condition], state: Mapping[Fact, bool]) -> list[str]:
    """The conditions of a stage that do not hold, as texts."""
    counts = (sum(state.get(fact, False) is value for fact, value in each.literals) for each in stage)
    met = ((each, each.least <= count <= each.most) for each, count in zip(stage, counts, strict=True))
    return [_describe_condition(each) for each, is_met in met if not is_met]


def _describe_condition(condition: Condition) -> str:
    return condition.text or _render(dict(condition.literals), [fact for fact, _ in condition.literals])


def _render(literals: Mapping[Fact, bool], facts: Sequence[Fact]) -> str:
    return ", ".join(fact if literals[fact] else f"not {fact}" for fact in facts)


def _read(text: str, problem: PlanningProblem) -> Plan | list[str]:
    """The plan of an answer, up to where the goal is reached, or its problems."""
    answer = read_object(text, ModelPlan)
    if isinstance(answer, list):
        return answer
    operators = {each.name: each for each in problem.operators}
    if strange := [f"no such action: {name}" for name in answer.steps if name not in operators]:
        return strange
    steps = [operators[name] for name in answer.steps]
    found = (check_plan(problem, steps[:count]) for count in range(1, len(steps)))
    return next((each for each in found if isinstance(each, Plan)), None) or check_plan(problem, steps)


def _describe(problem: PlanningProblem) -> tuple[Section, ...]:
    """The goal, what is true, and what each operator needs and changes, those first that bring about a part of it."""
    *first, last = ([_describe_condition(each) for each in stage] for stage in problem.stages)
    goal = {"goal": last} | ({"before, in this order": first} if first else {})
    wanted = {literal for stage in problem.stages for each in stage for literal in each.literals}
    operators = sorted(problem.operators, key=lambda each: (wanted.isdisjoint(each.changes.items()), each.cost))
    skills = {
        each.name: {
            "requires": _render(each.requires, [*each.requires]),
            "makes": _render(each.changes, [*each.changes]),
        }
        for each in operators
    }
    return (
        Section("question", goal),
        Section("skills", dict(skills)),
        Section("world", dict.fromkeys(sorted(problem.initial), True)),
    )
