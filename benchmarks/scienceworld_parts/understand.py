"""A goal from the description of a task: sentences of a few forms become sessions with what they are about.

Only the description is read. A form names no task: it says what words like *boil*, *grow* or *if it is above* ask for.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

PHASES = {"boil": "gas", "melt": "liquid", "freeze": "solid", "change the state of matter of": "other"}
LIMITS = {"timeout_s": 250, "wall_timeout_s": 600, "max_replans": 1}
OUTCOMES = {
    "change": "changed", "measure": "measured", "find_melting_point": "measured", "compare_slopes": "measured",
    "power": "powered", "try_conductor": "measured", "grow": "grown", "harvest": "grown", "cross": "measured",
    "bring": "brought", "bring_by": "brought",
}  # fmt: skip
"""The fact that a skill of this name leaves."""
GARDEN, OUTSIDE = "greenhouse", "outside"


@dataclass(frozen=True, slots=True)
class Step:
    """One session: its skill, arguments, and what is true once it has succeeded beyond what the skill guarantees."""

    skill: str
    arguments: Mapping[str, Any]


Form = tuple[str, Callable[[Mapping[str, str]], Sequence[Step]]]


def understand(description: str) -> tuple[Step, ...]:
    """The sessions that a description asks for, in order; raises ValueError where no form fits."""
    plain = " ".join(description.removeprefix("Your task is to ").split())
    for pattern, make in FORMS:
        if found := re.search(pattern, plain):
            return tuple(make(found.groupdict()))
    raise ValueError(f"no form fits {description!r}")


def _attend(what: str, room: str = "") -> Step:
    return Step("attend", {"what": what, "room": room})


def _choose(fact: str, at_least: float, first: str, second: str, room: str = "") -> Step:
    return Step("attend_by", {"fact": fact, "at_least": at_least, "first": first, "second": second, "room": room})


def _sort(what: str, fact: str, at_least: float, first: str, second: str, room: str = "") -> Step:
    choice = {"fact": fact, "at_least": at_least, "first": first, "second": second, "room": room}
    return Step("bring_by", {"what": what, **choice})


def _find(said: Mapping[str, str]) -> Sequence[Step]:
    return _attend(said["what"]), Step("bring", {"what": said["what"], "to": said["to"], "room": said["room"]})


def _change(said: Mapping[str, str]) -> Sequence[Step]:
    what = said["what"]
    return Step("hold", {"what": what}), _attend(what), Step("change", {"what": what, "to": PHASES[said["verb"]]})


def _measure(said: Mapping[str, str]) -> Sequence[Step]:
    what, room = said["what"], said["boxes"]
    measure = Step("measure", {"what": what, "room": room})
    sort = _sort(what, "temperature", float(said["bound"]), said["above"], said["below"], room)
    return Step("fetch", {"what": "thermometer"}), _attend("thermometer"), _attend(what, said["room"]), measure, sort


def _melt(said: Mapping[str, str]) -> Sequence[Step]:
    what, room = said["what"], said["boxes"]
    choose = _choose("melting_point", float(said["bound"]), said["above"], said["below"], room)
    first = Step("fetch", {"what": "thermometer"}), _attend("thermometer"), Step("hold", {"what": what})
    return *first, _attend(what), Step("find_melting_point", {"what": what}), choose


def _power(said: Mapping[str, str]) -> Sequence[Step]:
    source = said["source"] or "any"
    return _attend(said["what"]), Step("power", {"what": said["what"], "source": source, "room": "workshop"})


def _conduct(said: Mapping[str, str]) -> Sequence[Step]:
    what, room = said["what"], said["room"]
    attempt = Step("try_conductor", {"what": what, "room": room})
    return _attend(what, room), attempt, _sort(what, "conducts", 1.0, said["first"], said["second"])


def _mix_colours(said: Mapping[str, str]) -> Sequence[Step]:
    end, *between = said["what"], *(each for each in said["what"].split("-") if each in ("green", "orange", "violet"))
    colours = [f"{each} paint" for each in ((*between, end) if "-" in end else (end,))]
    return [step for each in colours for step in (Step("mix", {"what": each, "room": ""}), _attend(each))]


def _mix(said: Mapping[str, str]) -> Sequence[Step]:
    return Step("mix", {"what": said["what"], "room": said["room"]}), _attend(said["what"])


def _stages(said: Mapping[str, str]) -> Sequence[Step]:
    count = int(said["count"] or 4)
    what = said["what"].removesuffix(" plant")
    return (Step("attend_stages", {"what": what, "count": count, "room": OUTSIDE}),)


def _lifespan(said: Mapping[str, str]) -> Sequence[Step]:
    orders = (said["which"], said["then"]) if said["then"] else (said["which"],)
    return [Step("attend_lifespan", {"which": each, "room": OUTSIDE}) for each in orders]


def _slopes(said: Mapping[str, str]) -> Sequence[Step]:
    """Steep and smooth planes are fast; slow ones are shallow, or have much friction."""
    first, second = said["first"], said["second"]
    fast, slow = (first, second) if said["which"] in ("steepest angle", "least friction") else (second, first)
    compare = Step("compare_slopes", {"first": first, "second": second, "room": "workshop"})
    return compare, _choose("first_is_faster", 1.0, fast, slow)


def _grow(said: Mapping[str, str]) -> Sequence[Step]:
    what = said["what"]
    seed = Step("attend", {"what": f"{what} seed", "room": said["room"]})
    return seed, Step("grow", {"what": what, "stage": "reproducing"})


def _harvest(said: Mapping[str, str]) -> Sequence[Step]:
    return Step("harvest", {"what": said["what"]}), _attend(said["what"], GARDEN)


def _inherit(said: Mapping[str, str]) -> Sequence[Step]:
    cross = Step("cross", {"what": said["what"].removesuffix(" plant"), "trait": said["trait"]})
    return cross, _choose("dominant", 1.0, said["dominant"], said["recessive"])


FORMS: Sequence[Form] = (
    (r"^find a\(n\) (?P<what>[\w -]+)\. .* move it to the (?P<to>[\w ]+) in the (?P<room>[\w ]+)\.", _find),
    (r"^(?P<verb>boil|melt|freeze|change the state of matter of) (?P<what>[\w ]+)\.", _change),
    (
        r"^measure the temperature of (?P<what>[\w ]+), which is located around the (?P<room>[\w ]+)\. .*"
        r"is above (?P<bound>[-\d.]+) degrees celsius, place it in the (?P<above>[\w ]+)\. .*"
        r"place it in the (?P<below>[\w ]+)\. The boxes are located around the (?P<boxes>[\w ]+)\.",
        _measure,
    ),
    (
        r"^measure the melting point of (?P<what>[\w ]+), which is located around the (?P<room>[\w ]+)\. .*"
        r"is above (?P<bound>[-\d.]+) degrees celsius, focus on the (?P<above>[\w ]+)\. .*"
        r"focus on the (?P<below>[\w ]+)\. The boxes are located around the (?P<boxes>[\w ]+)\.",
        _melt,
    ),
    (r"^turn on the (?P<what>[\w ]+?)(?: by powering it using a (?P<source>\w+) power source)?\.", _power),
    (
        r"^determine if (?P<what>[\w ]+) is electrically conductive\. .* located around the (?P<room>[\w ]+?)\. .*"
        r"conductive, place it in the (?P<first>[\w ]+)\. .*conductive, place it in the (?P<second>[\w ]+)\.",
        _conduct,
    ),
    (r"^use chemistry to create (?P<what>[\w-]+) paint\.", _mix_colours),
    (r"^use chemistry to create the substance '(?P<what>[\w ]+)'\. .* near the (?P<room>[\w ]+)\.", _mix),
    (r"^focus on the (?:(?P<count>\d) )?life stages of the (?P<what>[\w ]+), starting", _stages),
    (
        r"^find the animal with the (?P<which>longest|shortest) life span"
        r"(?:, then the (?P<then>longest|shortest) life span)?\.",
        _lifespan,
    ),
    (
        r"^determine which of the two inclined planes \((?P<first>[\w ]+), (?P<second>[\w ]+)\) has the "
        r"(?P<which>[\w ]+)\.",
        _slopes,
    ),
    (r"^grow a (?P<what>[\w ]+) plant from seed\. Seeds can be found in the (?P<room>[\w ]+)\.", _grow),
    (r"^grow a (?P<what>[\w ]+)\. ", _harvest),
    (
        r"^determine whether (?P<trait>[\w ]+) is a dominant or recessive trait in the (?P<what>[\w ]+)\. "
        r"If the trait is dominant, focus on the (?P<dominant>[\w ]+)\. .*focus on the (?P<recessive>[\w ]+)\.",
        _inherit,
    ),
)


def write_goal(name: str, scene: str, steps: Sequence[Step]) -> dict[str, Any]:
    """The goal graph of these sessions, one after the other, as YAML has it."""
    sessions = {
        f"step_{number}": {
            **({"after": [f"step_{number - 1}"]} if number else {}),
            "skill": step.skill,
            "target": "agent",
            "with": {key: _spell(value) for key, value in step.arguments.items()},
        }
        for number, step in enumerate(steps)
    }
    return {
        "goal": name, "objective": f"Do what the description of {scene} asks for.", "scene": scene,
        "targets": {"agent": "scientist"}, "defaults": LIMITS, "sessions": sessions, "accept": [_list_outcome(steps)],
    }  # fmt: skip


def _spell(value: Any) -> Any:
    return "_".join(value.lower().replace("-", "_").split()) if isinstance(value, str) else value


def _list_outcome(steps: Sequence[Step]) -> str:
    """What holds at the end of all sessions, by their kinds: how often it attended, and that what was to be done is."""
    attends = sum(step.skill.startswith("attend") for step in steps)
    attends += sum(int(step.arguments["count"]) - 1 for step in steps if step.skill == "attend_stages")
    facts = [f"vital(attended) >= {attends}"] + [
        f"vital({fact}) >= 1" for skill, fact in OUTCOMES.items() if any(step.skill == skill for step in steps)
    ]
    return " and ".join(facts)
