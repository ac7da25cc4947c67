"""Reads and checks a goal without a plan, with the checks of goal graphs."""

from collections.abc import Iterator
from pathlib import Path

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.checks import Checks
from phyagentos.agent.goals.spec import GoalSpec
from phyagentos.agent.goals.wanted import WantedGoal
from phyagentos.agent.planning.domain import read_goal
from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.documents.schema import Located, read_yaml, salvage


def read_wanted(path: Path, catalogue: Catalogue) -> WantedGoal:
    """Read one file.

    Raises:
        DefinitionError: With every problem at file:line:column: names that scene, skills and targets do not hold,
            predicates that cannot be parsed, or for which no plan can be made.
    """
    wanted, problems = salvage(WantedGoal, located := read_yaml(path))
    problems = [*problems, *(_iter_problems(wanted, located, catalogue) if wanted is not None else ())]
    if wanted is None or problems:
        raise DefinitionError(problems)
    return wanted


def _iter_problems(wanted: WantedGoal, located: Located, catalogue: Catalogue) -> Iterator[Problem]:
    fields = wanted.model_dump(include={"goal", "objective", "scene", "targets", "constraints", "accept"})
    checks = Checks(GoalSpec.model_construct(**fields), {}, located, catalogue)
    found = list(checks.check_spec())
    names = {*wanted.targets, *catalogue.targets, "target"}
    for index, step in enumerate(wanted.steps):
        for place, text in enumerate(step):
            found += checks.check_predicate(("steps", index, place), text, names)
    yield from found
    if not found:
        try:
            read_goal(wanted, (), wanted.targets, located.address_of)
        except DefinitionError as error:
            yield from error.problems
