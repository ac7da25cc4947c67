"""Electrical circuits: devices that are powered, and substances that are tried in one."""

from collections.abc import Generator, Sequence

from target_server.tool_body import Steps, ToolFailed

from scienceworld_body.agent import Agent

SOURCES = {
    "any": ("battery", "solar panel", "wind generator", "wind mill", "gas generator", "nuclear generator"),
    "renewable": ("solar panel", "wind generator", "wind mill"),
    "nonrenewable": ("gas generator", "nuclear generator", "battery"),
}
"""What gives power, by kind: knowledge that is given."""
OUTDOORS = ("solar panel", "wind generator", "wind mill")
POLES = ("anode", "cathode")
SETTLE = 2  # steps until a lamp shows what flows


def power(agent: Agent, what: str, source: str, room: str) -> Steps[str]:
    """Connect a device with two wires to a source of a kind, out of doors where it needs sun or wind."""
    yield from agent.enter(room)
    name = next((each for each in SOURCES[source] if any(seen.name == each for seen in agent.room.seen)), "")
    if not name:
        raise ToolFailed(f"no {source} source of power is in the {room}")
    wires = _list_wires(agent, 2)
    if name in OUTDOORS:
        for each in (what, name, *wires):
            yield from agent.fetch(each)
        yield from agent.enter("outside")
        for each in (what, name):
            yield from agent.do(f"put down {each}")
    elif name != "battery":
        yield from agent.do(f"activate {name}")
    for ends in (POLES[::-1], POLES):
        for wire, pole, end in zip(wires, POLES, ends, strict=True):
            yield from _connect(agent, f"{name} {pole}", wire, f"{what} {end}")
        if (yield from _is_on(agent, what)):
            agent.facts["powered"] = 1.0
            return f"the {what} is on"
        for wire in wires:
            yield from agent.do(f"disconnect {wire}")
    raise ToolFailed(f"the {what} stays off with the {name}")


def try_conductor(agent: Agent, what: str, room: str) -> Steps[str]:
    """Close a circuit of battery, lamp and three wires by it: it conducts where the lamp is on."""
    yield from agent.enter(room)
    yield from agent.find(agent.match(what), what)
    lamp = agent.get(lambda each: each.name.endswith("light bulb"), "light bulb").name
    one, two, three = _list_wires(agent, 3)
    tried = agent.get(agent.match(what), what).name
    yield from _connect(agent, "battery anode", one, f"{lamp} cathode")
    yield from _connect(agent, f"{lamp} anode", two, f"{tried} terminal 1")
    yield from _connect(agent, f"{tried} terminal 2", three, "battery cathode")
    agent.facts |= {"conducts": float((yield from _is_on(agent, lamp))), "measured": 1.0}
    return f"the {lamp} is {'on' if agent.facts['conducts'] else 'off'}"


def _connect(agent: Agent, first: str, wire: str, second: str) -> Steps[str]:
    yield from agent.do(f"connect {first} to {wire} terminal 1")
    return (yield from agent.do(f"connect {wire} terminal 2 to {second}"))


def _list_wires(agent: Agent, n: int) -> Sequence[str]:
    found = [each.name for each in agent.room.seen if each.name.endswith(" wire")]
    if len(found) < n:
        raise ToolFailed(f"{len(found)} wires are in view; {n} are needed")
    return found[:n]


def _is_on(agent: Agent, what: str) -> "Generator[str, None, bool]":
    for _ in range(SETTLE):
        yield "wait1"
        if agent.get(agent.match(what), what).has("which is on"):
            return True
    return False
