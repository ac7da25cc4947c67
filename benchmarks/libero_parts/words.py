"""The objects of a goal by the words of their names alone, for who knows nothing else of them.

What a camera tells by itself, without a detector that has learned more words, are colours and plain forms.
"""

from collections.abc import Iterable
from typing import Any

from benchmarks.libero_parts.bddl import Inventory, generate_graph, read_goal, translate
from phyagentos.errors import DefinitionError, Problem, format_names
from phyagentos.protocol.world.descriptions import COLORS, FORMS
from phyagentos.protocol.world.environment import UNNAMED, Entity, Pose


def describe_names(names: Iterable[str]) -> dict[str, str]:
    """Each name's description: `the black object` for `black_pot_1`.

    Raises:
        DefinitionError: `UNKNOWN_NAME` for each name that has neither a colour nor a form.
    """
    described, problems = dict[str, str](), list[Problem]()
    for name in dict.fromkeys(names):
        color, form = (next((word for word in name.split("_") if word in known), "") for known in (COLORS, FORMS))
        described[name] = " ".join(filter(None, ("the", color, form or "thing")))
        if not color and not form:
            expected = f"a colour, or a form: {format_names([*COLORS, *FORMS])}"
            problems.append(Problem("UNKNOWN_NAME", "goal", repr(name), expected, kind="word"))
    if problems:
        raise DefinitionError(problems)
    return described


def generate_from_words(name: str, objective: str, scene: str, goal: str, target: str) -> dict[str, Any]:
    """The goal graph of a goal in BDDL whose objects are given by description.

    Raises:
        DefinitionError: `UNKNOWN_NAME`, also for what opens: no word tells of a joint.
    """
    described = describe_names(term for _, *terms in read_goal(goal) for term in terms)
    objects = {each: Entity(name=each, kind=UNNAMED, pose=Pose()) for each in described}
    inventory = Inventory(entities=objects)
    graph = generate_graph(name, objective, scene, translate(goal, inventory), inventory, target)
    return graph | {"described": described}
