"""Problems of amounts as PDDL 2.1 with numeric fluents, for planners and validators of others.

One action without parameters is one application of an activity; where that would raise a vital above its most, a second
one sets it there. Each stage but the last one is a fact that an action notes. A limit on the number of sessions has no
counterpart, as an action is no session.
"""

import math
from collections.abc import Iterator, Mapping

from phyagentos.agent.planning.amounts import Activity, AmountProblem, Bounds, Resource

_TIME = "(elapsed_s)"
FULL = "_full"


def write_pddl(problem: AmountProblem, name: str) -> tuple[str, str]:
    """The domain, and the problem; amounts of tools that wear are uses."""
    functions = [*map(_name, problem.resources), _TIME]
    stages = range(len(problem.stages) - 1)
    actions = [text for index, each in enumerate(problem.activities) for text in _iter_actions(each, index, problem)]
    for index in stages:
        before = [f"(reached_{index - 1})"] if index else []
        actions.append(_action(f"reach_{index}", [*before, *_bound(problem.stages[index])], [f"(reached_{index})"]))
    domain = [
        f"(define (domain {name})",
        "  (:requirements :strips :fluents)",
        f"  (:predicates {' '.join(f'(reached_{index})' for index in stages)})" if stages else "",
        f"  (:functions {' '.join(functions)})",
        *actions,
    ]
    initial = [f"(= {_name(each)} {problem.initial.get(each, 0.0):g})" for each in problem.resources]
    wanted = [*_bound(problem.stages[-1]), *(f"(reached_{index})" for index in stages)]
    wanted += [f"(<= {_TIME} {problem.time_s:g})"] if problem.time_s is not None else []
    task = [
        f"(define (problem {name}_task) (:domain {name})",
        f"  (:init {' '.join(initial)} (= {_TIME} 0))",
        f"  (:goal {_join(wanted)})",
        f"  (:metric minimize {_TIME})",
    ]
    return "\n".join(filter(None, domain)) + ")\n", "\n".join(task) + ")\n"


def name_action(activity: Activity, index: int) -> str:
    """The name that the activity of this place has in a domain."""
    return f"{activity.skill}_{activity.made.subject}_{index}".lower()


def _iter_actions(activity: Activity, index: int, problem: AmountProblem) -> Iterator[str]:
    changes = {name: activity.makes.get(name, 0.0) - activity.uses.get(name, 0.0) for name in problem.resources}
    needs = []
    for name in problem.resources:
        floor, used = problem.least.get(name, 0.0), activity.uses.get(name, 0.0)
        if used or name in activity.needs:
            needs.append(f"(>= {_name(name)} {max(floor, activity.needs.get(name, 0.0)) + used:g})")
    effects = {name: f"({_verb(change)} {_name(name)} {abs(change):g})" for name, change in changes.items() if change}
    took = f"(increase {_TIME} {activity.time_s:g})"
    capped = {name: most for name, most in problem.most.items() if changes.get(name, 0.0) > 0}
    fits = [f"(<= {_name(name)} {most - changes[name]:g})" for name, most in capped.items()]
    yield _action(name_action(activity, index), needs + fits, [*effects.values(), took])
    if capped:
        full = effects | {name: f"(assign {_name(name)} {most:g})" for name, most in capped.items()}
        over = [f"(>= {_name(name)} {most - changes[name]:g})" for name, most in capped.items()]
        yield _action(f"{name_action(activity, index)}{FULL}", needs + over, [*full.values(), took])


def _action(name: str, needs: list[str], effects: list[str]) -> str:
    return f"  (:action {name} :parameters ()\n    :precondition {_join(needs)}\n    :effect {_join(effects)})"


def _bound(stage: Mapping[Resource, Bounds]) -> list[str]:
    bounds = [(f"(>= {_name(name)} {low:g})", low > 0) for name, (low, _) in stage.items()]
    bounds += [(f"(<= {_name(name)} {high:g})", high < math.inf) for name, (_, high) in stage.items()]
    return [text for text, is_bound in bounds if is_bound]


def _name(resource: Resource) -> str:
    return f"({resource.meaning}_{resource.subject})".lower()


def _verb(change: float) -> str:
    return "increase" if change > 0 else "decrease"


def _join(parts: list[str]) -> str:
    return f"(and {' '.join(parts)})"
