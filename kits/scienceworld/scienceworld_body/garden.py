"""Growing plants: pots, soil, seeds and water, bees for fruit, and what the next generation shows."""

from collections.abc import Generator, Iterator

from target_server.tool_body import Steps, ToolFailed

from scienceworld_body.agent import HIVE, Agent, is_of, is_plant, spell
from scienceworld_body.reading import CARRIED, Seen

GARDEN = "greenhouse"
PATIENCE = 150  # rounds of watering
OFFSPRING = 12  # seeds of the next generation of which most show what is dominant


def grow(agent: Agent, what: str, stage: str) -> Steps[str]:
    """Sow the seeds of a plant, and water them until a plant in each pot with one has reached a stage.

    Seeds of a kind look the same, so the one that was attended to may be any of them.
    """
    yield from sow(agent, what)
    for _ in range(PATIENCE):
        pots = {pot: {each.stage for each in inside} for pot, inside in _list_planted(agent, what).items()}
        if pots and all(stage in stages for stages in pots.values()):
            agent.facts["grown"] = 1.0
            return f"{len(pots)} of {what} are {stage}"
        yield from _water(agent)
        yield "wait1"
    raise ToolFailed(f"not each {what} became {stage} in {PATIENCE} rounds")


def harvest(agent: Agent, what: str) -> Steps[str]:
    """Grow several plants, let bees pollinate them, and wait for fruit of this name."""
    yield from sow(agent, what)
    yield from _shut(agent)
    for _ in range(PATIENCE):
        if any(_is_fruit(each, what) for each in agent.room.seen):
            agent.facts["grown"] = 1.0
            return f"a {what} has grown"
        yield from _water(agent)
        yield "wait1"
    raise ToolFailed(f"no {what} grew in {PATIENCE} rounds")


def cross(agent: Agent, what: str, trait: str) -> Steps[str]:
    """Grow two parents that differ, and see what most of their offspring show: its trait is dominant.

    A trait of seeds shows in the seeds that the parents bear; another one in the plants that grow of these.
    """
    value = trait.split(maxsplit=1)[0]
    yield from sow(agent, what)
    yield from _shut(agent)
    for _ in range(PATIENCE):
        born = _list_born(agent, what)
        if len(born) >= OFFSPRING:
            break
        yield from _water(agent)
        yield "wait1"
    shown = [each.name for each in born]
    if " seed " not in f" {trait} ":
        shown = yield from _watch(agent, (yield from _sow_born(agent, what)))
    if not shown:
        raise ToolFailed(f"no offspring of {what} in {PATIENCE} rounds")
    share = sum(value in each.split() for each in shown) / len(shown)
    agent.facts |= {"dominant": float(share >= 0.5), "measured": 1.0}
    return f"{share:.0%} of {len(shown)} offspring are {value}"


def _list_born(agent: Agent, what: str) -> list[Seen]:
    """Seeds on or under a plant that has grown: each pot was sown with one, so these are its offspring."""
    pots = [pot for pot in _list_pots(agent) if any(map(_is_grown, agent.list_inside(pot)))]
    return [each for pot in pots for each in agent.list_inside(pot) if _is_seed(each, what)]


def _sow_born(agent: Agent, what: str) -> "Generator[str, None, list[str]]":
    """One of the offspring into each pot without a plant, while there are any; these pots."""
    pots = [pot for pot in _list_pots(agent) if not any(map(is_plant, agent.list_inside(pot)))]
    for count, pot in enumerate(pots):
        if not (born := _list_born(agent, what)):
            return pots[:count]
        yield from agent.do(f"move {born[0].name} to {pot}", *born[0].inside)
    return pots


def _watch(agent: Agent, pots: list[str]) -> "Generator[str, None, list[str]]":
    """What was said of the plant in each of these pots while it grew, when all have flowered."""
    said = {pot: dict[str, None]() for pot in pots}
    for _ in range(PATIENCE):
        for pot, texts in said.items():
            texts.update((each.text, None) for each in agent.list_inside(pot) if _is_grown(each) or _is_flower(each))
        if all(any("flower" in text or "reproducing" in text for text in texts) for texts in said.values()):
            break
        yield from _water(agent)
        yield "wait1"
    return [" ".join(texts) for texts in said.values() if texts]


def sow(agent: Agent, what: str) -> Steps[str]:
    """A seed in each pot of the garden, with soil and water."""
    yield from agent.find(lambda each: _is_seed(each, what), f"{what} seed")
    seed = agent.get(lambda each: _is_seed(each, what), f"{what} seed")
    if CARRIED not in seed.inside and seed.inside:
        yield from agent.do(f"pick up {seed.inside[0]}")
    yield from agent.enter(GARDEN)
    sown = 0
    for pot in _list_pots(agent):
        seeds = [each for each in agent.room.seen if _is_seed(each, what) and CARRIED in each.inside]
        if not seeds:
            break
        seeds.sort(key=lambda each: len(each.inside))  # one that was taken out is the one that was attended to
        if not any(each.name == "soil" for each in agent.list_inside(pot)):
            yield from _fetch_soil(agent)
            yield from agent.do(f"move soil in inventory to {pot}", "inventory")
        yield from agent.do(f"move {seeds[0].name} to {pot}", seeds[0].inside[0])
        sown += 1
    yield from _water(agent)
    return f"{sown} seeds of {what}"


def _fetch_soil(agent: Agent) -> Iterator[str]:
    if not any(each.name == "soil" and not each.inside for each in agent.room.seen):
        yield from agent.fetch("shovel")
        yield from agent.enter("outside")
        yield from agent.do("use shovel on ground")
    yield from agent.do("pick up soil", agent.room.name)
    yield from agent.enter(GARDEN)


def _water(agent: Agent) -> Iterator[str]:
    """Pour water into every pot that has a seed or a plant and no water."""
    for pot in _list_pots(agent):
        inside = agent.list_inside(pot)
        if not any(is_plant(each) for each in inside) or any(each.name == "water" for each in inside):
            continue
        if not any(each.name == "jug" and each.inside[:1] == ("sink",) for each in agent.room.seen):
            yield from agent.do("activate sink")
            yield from agent.put("jug", "sink")
        yield from agent.do(f"pour jug into {pot}")
        yield from agent.put("jug", "sink")


def _shut(agent: Agent) -> Iterator[str]:
    """Close the doors, so that the bees stay, and let them out of their hive."""
    for room, is_open in agent.room.doors.items():
        if is_open:
            yield from agent.do(f"close door to {room}")
    if any(each.name == HIVE for each in agent.room.seen):
        yield from agent.do(f"open {HIVE}")


def _list_planted(agent: Agent, what: str) -> dict[str, list[Seen]]:
    """Seeds and plants of a kind by the pot that they are in."""
    inside = {pot: [each for each in agent.list_inside(pot) if is_of(each, what)] for pot in _list_pots(agent)}
    return {pot: found for pot, found in inside.items() if any(map(is_plant, found))}


def _list_pots(agent: Agent) -> list[str]:
    return [each.name for each in agent.room.seen if "flower pot" in each.name]


def _is_seed(seen: Seen, what: str) -> bool:
    return seen.stage == "seed" and is_of(seen, what)


def _is_grown(seen: Seen) -> bool:
    return is_plant(seen) and seen.stage != "seed"


def _is_flower(seen: Seen) -> bool:
    return seen.name.endswith("flower")


def _is_fruit(seen: Seen, what: str) -> bool:
    return not seen.stage and spell(seen.name).endswith(spell(what)) and CARRIED not in seen.inside
