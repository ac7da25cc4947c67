"""Finding, attending and bringing: skills that need eyes and hands alone."""

from target_server.tool_body import Steps, ToolFailed

from scienceworld_body.agent import KINDS, Agent, is_animal, is_of
from scienceworld_body.reading import CARRIED, Seen

YOUNG = {"baby", "hatchling", "tadpole", "caterpillar", "larva", "nymph"}
ANIMAL = ({"egg"}, YOUNG, {"juvenile", "pupa"}, {"adult"})
PLANT = ({"seed"}, {"seedling"}, {"adult"}, {"reproducing"})
"""Stages of a life, the earliest first."""
PATIENCE = 60  # steps in which the next stage of a life has come
YEARS = {
    "giant tortoise": 150, "parrot": 80, "elephant": 65, "crocodile": 60, "turtle": 50, "brown bear": 30, "beaver": 15,
    "wolf": 13, "dove": 12, "frog": 10, "common toad": 9, "rabbit": 9, "blue jay": 7, "chameleon": 6, "hedgehog": 5,
    "chipmunk": 8, "mouse": 2, "ant": 1, "bee": 0.3, "dragonfly": 0.25, "butterfly": 0.1,
}  # fmt: skip
"""How old animals become [years]: knowledge that is given."""


def attend(agent: Agent, what: str, room: str) -> Steps[str]:
    """Find it, in this room where one is named, and say that it is meant; of a kind, one that can be carried."""
    if room:
        yield from agent.enter(room)
    if what in KINDS:
        name = yield from _choose(agent, what)
        return (yield from _focus(agent, agent.get(agent.match(what), name)))
    yield from agent.find(agent.match(what), what)
    seen = agent.get(agent.match(what), what)
    if seen.stage == "seed" and sum(each.name == seen.name for each in agent.room.seen) > 1:
        yield from agent.do(f"pick up {seen.name}", *seen.inside[:1])  # its place distinguishes it from its like
        seen = agent.get(agent.match(what), what)
    return (yield from _focus(agent, seen))


def fetch(agent: Agent, what: str) -> Steps[str]:
    """Find it and carry it."""
    return (yield from agent.fetch(what))


def bring(agent: Agent, what: str, to: str, room: str) -> Steps[str]:
    """Carry it to a room, where one is named, and move it into something there."""
    yield from agent.fetch(what)
    if room:
        yield from agent.enter(room)
    yield from agent.find(agent.match(to), to)
    said = yield from agent.put(what, to)
    agent.facts["brought"] = float(agent.filled[to])
    return said


def attend_stages(agent: Agent, what: str, count: int, room: str) -> Steps[str]:
    """Attend to the stages of a life in their order, by individuals that are in one, or come into it."""
    yield from agent.enter(room)
    attended, last, waited = 0, -1, 0
    while attended < count and waited < PATIENCE:
        later = sorted(
            (rank, n) for n, each in enumerate(agent.room.seen) if is_of(each, what) and (rank := _rank(each)) > last
        )
        if later and (not attended or later[0][0] == last + 1 or waited >= PATIENCE // 2):
            yield from _focus(agent, agent.room.seen[later[0][1]])
            attended, last, waited = attended + 1, later[0][0], 0
        else:
            yield "wait1"
            waited += 1
    return f"{attended} of {count} stages"


def attend_lifespan(agent: Agent, which: str, room: str) -> Steps[str]:
    """Attend to the animal of a room that becomes oldest (`longest`), or dies youngest (`shortest`)."""
    yield from agent.enter(room)
    known = {each: years for each in agent.room.seen for name, years in YEARS.items() if is_of(each, name)}
    known = {each: years for each, years in known.items() if is_animal(each)}
    if not known:
        raise ToolFailed("no animal whose age is known is in view")
    choose = max if which == "longest" else min
    return (yield from _focus(agent, choose(known, key=lambda each: known[each])))


def _choose(agent: Agent, kind: str) -> Steps[str]:
    """One of a kind that can be carried, and is carried now."""
    refused = set[str]()
    matches = KINDS[kind]
    while True:
        yield from agent.find(lambda each: matches(each) and each.name not in refused, kind)
        seen = agent.get(lambda each: matches(each) and each.name not in refused, kind)
        yield from agent.do(f"pick up {seen.name}", *seen.inside[:1])
        if any(each.name == seen.name and CARRIED in each.inside for each in agent.room.seen):
            species = [word for word in seen.name.split() if word not in set[str]().union(*ANIMAL, *PLANT)]
            agent.names[kind] = " ".join(species) or seen.name
            return seen.name
        refused.add(seen.name)


def _focus(agent: Agent, seen: Seen) -> Steps[str]:
    said = yield from agent.do(f"focus on {agent.refer(seen)}", *seen.inside[:1])
    agent.facts["attended"] = agent.facts.get("attended", 0.0) + 1.0
    return said


def _rank(seen: Seen) -> int:
    """Of the stage that it is in; -1 where it has none."""
    life = ANIMAL if is_animal(seen) else PLANT
    return next((rank for rank, names in enumerate(life) if seen.stage in names), -1)
