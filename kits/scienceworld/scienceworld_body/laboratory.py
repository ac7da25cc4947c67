"""Heating, cooling, measuring and mixing: skills of a laboratory, by what is seen of a substance."""

import contextlib
import re
from collections.abc import Callable, Generator

from target_server.tool_body import Steps, ToolFailed

from scienceworld_body.agent import VESSELS, Agent, spell
from scienceworld_body.reading import CARRIED, Seen

HEATERS = ("stove", "hot plate", "oven", "blast furnace", "fire pit")
COOLERS = ("freezer", "ultra low temperature freezer", "fridge")
HEATING = 40  # actions until a device has done what it can
PHASES = {"ice": "solid", "water": "liquid", "steam": "gas"}
PREFIXES = {"solid": "solid", "liquid": "liquid", "gaseous": "gas"}
FLUIDS = ("water", "juice", "paint", "milk", "vinegar", "acid")
RECIPES = {
    "green paint": ("blue paint", "yellow paint"), "orange paint": ("red paint", "yellow paint"),
    "violet paint": ("red paint", "blue paint"),
}  # fmt: skip
"""How colours mix: knowledge that is given; other recipes are read where they are found."""
BASINS = ("sink", "toilet", "fountain", "bathtub")
BLOCKS = ("block", "brick")
COLOURS = {"red", "yellow", "blue", "green", "orange", "violet"}


def hold(agent: Agent, what: str) -> Steps[str]:
    """Have a substance alone in a vessel that is carried; water from a tap where there is one."""
    vessel = yield from _take_empty(agent)
    yield from _add(agent, what, vessel)
    return vessel


def change(agent: Agent, what: str, to: str) -> Steps[str]:
    """Heat or cool a substance that is held until it is `solid`, `liquid`, `gas`, or `other` than it was.

    What is liquid already is frozen before it is melted, what is solid melted before it is frozen.
    """
    vessel = _find_vessel(agent, what)

    def read() -> str:
        return _read_phase(agent, vessel, what)

    before = read()
    if to in ("gas", "other"):
        wanted = {"gas"} if to == "gas" else {"solid", "liquid", "gas", ""} - {before}
        yield from _treat(agent, vessel, HEATERS, read, lambda now: now in wanted)
    else:
        first, others = ("liquid", (HEATERS, COOLERS)) if to == "solid" else ("solid", (COOLERS, HEATERS))
        if before != first:
            yield from _treat(agent, vessel, others[0], read, lambda now: now in (first, "gas"), strict=False)
        middle = read()
        yield from _treat(agent, vessel, others[1], read, lambda now: now == to or (now == "" and middle == first))
    after = read()
    agent.facts["changed"] = 1.0
    return f"{what} was {before or 'as usual'}, is {after or 'as usual'}"


def measure(agent: Agent, what: str, room: str) -> Steps[str]:
    """Carry it to a room, where one is named, and measure its temperature [degrees Celsius] there."""
    yield from agent.fetch("thermometer")
    yield from agent.fetch(what)
    yield from _read_thermometer(agent, what)
    if room:
        yield from agent.enter(room)
    agent.facts["temperature"] = yield from _read_thermometer(agent, what)
    agent.facts["measured"] = 1.0
    return f"{what} has {agent.facts['temperature']:g} degrees Celsius"


def find_melting_point(agent: Agent, what: str) -> Steps[str]:
    """Heat a substance that is held, step by step, until it is no longer what it was: its melting point.

    Of what becomes a gas at once, or is not solid when it begins, only an upper bound is known: where it began.
    """
    yield from agent.fetch("thermometer")
    vessel = _find_vessel(agent, what)
    inside = _list_content(agent, vessel)
    if not inside:
        raise ToolFailed(f"no {what} is in the {vessel}")
    name = inside[0].name
    before = _read_phase(agent, vessel)
    agent.facts |= {"melting_point": (yield from _read_thermometer(agent, name)), "measured": 1.0}
    if before != "liquid":
        after = yield from _watch(agent, vessel, HEATERS, lambda now: now != before)
        if after != "gas":
            return f"{what} melts at {agent.facts['melting_point']:g} degrees Celsius"
    yield from _watch(agent, vessel, COOLERS, lambda now: now == "solid")
    return f"{what} freezes at {agent.facts['melting_point']:g} degrees Celsius"


def _watch(agent: Agent, vessel: str, devices: tuple[str, ...], is_done: Callable[[str], bool]) -> Steps[str]:
    """Leave a vessel in devices until the phase of what it holds is such, with readings; its phase then."""
    for device in devices:
        if not (yield from _set_on(agent, vessel, device)):
            continue
        for _ in range(HEATING):
            phase = _read_phase(agent, vessel)
            if phase == "gone":
                return "gas"
            agent.facts["melting_point"] = yield from _read_thermometer(agent, _list_content(agent, vessel)[0].name)
            if is_done(phase):
                return phase
    return _read_phase(agent, vessel)


def mix(agent: Agent, what: str, room: str) -> Steps[str]:
    """Make a substance of others, by a recipe that is known or found and read."""
    if room:
        yield from agent.enter(room)
    *colours, _ = what.split()
    if len(colours) > 1 and {*colours} <= COLOURS:
        parts: tuple[str, ...] = tuple(f"{each} paint" for each in colours)
    elif what in RECIPES:
        parts = RECIPES[what]
    else:
        yield from agent.find(lambda each: each.name == "recipe" and each.has(what), f"recipe of {what}")
        said = yield from agent.do("read recipe")
        found = re.search(r"you need to mix (.*?)\.", said)
        if found is None:
            raise ToolFailed(f"the recipe says {said!r}")
        parts = tuple(found[1].split(", "))
    held = [
        each.inside[0]
        for part in parts
        for each in agent.room.seen
        if _is_substance(each, part) and each.inside[1:] == (CARRIED,)
    ]
    vessel = held[0] if held else (yield from _take_empty(agent))
    for part in parts:
        if not any(_is_substance(each, part) for each in _list_content(agent, vessel)):
            yield from _add(agent, part, vessel)
    return (yield from agent.do(f"mix {vessel}", CARRIED))


def compare_slopes(agent: Agent, first: str, second: str, room: str) -> Steps[str]:
    """Let a block slide down two planes for a while each, by the stopwatch: which is faster."""
    yield from agent.enter(room)
    slid = dict[str, float]()
    for name in (first, second):
        plane = agent.get(_match_plane(name), name).name
        yield from agent.do("activate stopwatch")
        block = agent.get(lambda each: each.name.endswith(BLOCKS), "block").name
        yield from agent.do(f"move {block} to {plane}")
        for _ in range(3):
            yield "wait1"
        seen = agent.get(_match_plane(name), name)
        found = re.search(r"approximately (\d+)%", seen.text)
        slid[name] = float(found[1]) if found else 100.0
        yield from agent.do("deactivate stopwatch")
        yield from agent.do("examine stopwatch")
        yield from agent.do(f"pick up {block}")
        agent.names[name] = plane
    agent.facts |= {"first_is_faster": float(slid[first] > slid[second]), "measured": 1.0}
    return f"in the same time it slid {slid[first]:g} and {slid[second]:g} percent"


def _match_plane(name: str) -> Callable[[Seen], bool]:
    plain = name.removeprefix("inclined plane ")
    return lambda each: (
        "inclined plane" in each.name
        and bool(re.search(rf"\b{re.escape(plain)}( surface)?$", each.name, re.IGNORECASE))
    )


def _take_empty(agent: Agent) -> Steps[str]:
    def is_empty(seen: Seen) -> bool:
        return seen.name in VESSELS and not seen.holds

    with contextlib.suppress(ToolFailed):  # metal stands heat
        yield from agent.find(lambda each: is_empty(each) and each.name == VESSELS[0], VESSELS[0])
    yield from agent.find(is_empty, "empty vessel")
    found = sorted(filter(is_empty, agent.room.seen), key=lambda each: VESSELS.index(each.name))
    yield from agent.do(f"pick up {found[0].name}", *found[0].inside[:1])
    return found[0].name


def _add(agent: Agent, what: str, vessel: str) -> Steps[str]:
    """Put a substance into a vessel that is carried, from where it is found."""
    try:
        yield from agent.find(lambda each: _is_substance(each, what), what)
    except ToolFailed:
        if what != "water":
            raise
        return (yield from _fill(agent, vessel))
    seen = agent.get(lambda each: _is_substance(each, what), what)
    source = seen.inside[0] if seen.inside else ""
    is_poured = seen.has("substance") or what.endswith(FLUIDS)
    if is_poured and (source in VESSELS or source.endswith(("cup", "jar"))):
        pour = f"pour {source.split()[-1]} containing {seen.name} into {vessel}"
        if source.endswith("jar"):
            yield f"open {source}"
        return (yield from agent.do(pour, *seen.inside, CARRIED))
    if source in BASINS and what.endswith(FLUIDS):
        return (yield from agent.do(f"dunk {vessel} into {source}"))
    return (yield from agent.do(f"move {what} to {vessel}", *seen.inside[:1], CARRIED))


def _is_substance(seen: Seen, what: str) -> bool:
    return f" {spell(seen.name)}".endswith(f" {spell(what)}")


def _fill(agent: Agent, vessel: str) -> Steps[str]:
    yield from agent.find(lambda each: each.name == "sink", "sink")
    yield from agent.put(vessel, "sink")
    yield from agent.do("activate sink")
    yield from agent.do("deactivate sink")
    return (yield from agent.do(f"pick up {vessel}", "sink"))


def _find_vessel(agent: Agent, what: str) -> str:
    """The vessel in view in which a substance is; empty where there is none."""
    found = [each for each in agent.room.seen if _is_substance(each, what) and each.inside]
    return next((each.inside[0] for each in found if each.inside[0] in VESSELS), "")


def _list_content(agent: Agent, vessel: str) -> list[Seen]:
    return [each for each in agent.room.seen if each.inside[:1] == (vessel,)]


def _read_phase(agent: Agent, vessel: str, what: str = "") -> str:
    """Of what a vessel holds, or once held: as it is named; empty where its name says nothing, `gone` if out of view.

    A vessel of metal may melt under what it holds.
    """
    found = _list_content(agent, vessel) or [each for each in agent.room.seen if what and _is_substance(each, what)]
    if not found:
        return "gone"
    name = found[0].name
    return PHASES.get(name) or PREFIXES.get(name.split()[0], "")


def _treat(
    agent: Agent,
    vessel: str,
    devices: tuple[str, ...],
    read: Callable[[], str],
    is_done: Callable[[str], bool],
    *,
    strict: bool = True,
) -> Steps[str]:
    """Leave a vessel in one device after the other until that is done; raises `ToolFailed` where none does it."""
    for device in devices:
        if not (yield from _set_on(agent, vessel, device)):
            continue
        for _ in range(HEATING):
            if is_done(read()):
                return device
            yield "wait1"
    if strict:
        raise ToolFailed(f"what is in the {vessel} is {read()} in each of {', '.join(devices)}")
    return ""


def _set_on(agent: Agent, vessel: str, device: str) -> Steps[str]:
    """Put a vessel on a device that works; empty where there is none such."""
    yield from agent.fetch(vessel)
    try:
        yield from agent.find(lambda each: each.name == device, device)
    except ToolFailed:
        return ""
    if device == "fire pit":
        yield from agent.fetch("lighter")
        yield from agent.find(lambda each: each.name == device, device)
        yield from agent.put("wood", device)
        yield from agent.do("use lighter on wood")
    elif device in HEATERS:
        yield f"activate {device}"
        if "broken" in agent.said:
            return ""
    yield from agent.put(vessel, device)
    return device


def _read_thermometer(agent: Agent, what: str) -> "Generator[str, None, float]":
    said = yield from agent.do(f"use thermometer on {agent.get(agent.match(what), what).name}")
    found = re.search(r"temperature of (-?\d+)", said)
    if found is None:
        raise ToolFailed(f"the thermometer says {said!r}")
    return float(found[1])
