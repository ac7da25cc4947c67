"""Questions about the world: what a reading asks for, and the answer that a snapshot gives, with its evidence.

Upstream: a reading. Downstream: `paos ask`. An answer is what the predicates of the goal language say of the snapshot;
what they leave unknown is answered as unknown, and never guessed.
"""

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

import msgspec

from phyagentos.agent.understanding.bearings import SIDES, list_most
from phyagentos.agent.understanding.clauses import Clauses
from phyagentos.agent.understanding.discourse import Slot
from phyagentos.agent.understanding.phrases import Node, find_child, has_token, list_children
from phyagentos.agent.understanding.steps import list_flipped, says
from phyagentos.agent.understanding.understanding import Inquiry, InquiryKind, RequestProblemKind
from phyagentos.agent.understanding.vocabulary import read_lexicon
from phyagentos.protocol.predicates.evaluation import Evaluation
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.predicate import parse_predicate
from phyagentos.protocol.predicates.relations import find_places
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.truth import Truth
from phyagentos.wording import format_length

_WORDS = {Truth.TRUE: "yes", Truth.FALSE: "no", Truth.UNKNOWN: "unknown"}


class Answer(msgspec.Struct, frozen=True, kw_only=True):
    """An answer in a line, and a line of evidence for each object."""

    answer: str
    evidence: tuple[str, ...] = ()


def read_inquiry(said: Clauses, question: Node) -> Inquiry:
    """What a question is about; what it leaves open, or names without being here, is noted in `said`."""
    kind, statements = _KINDS[question.data], dict[str, str]()
    parts = [part for part in list_children(question) if part.data != "be"]
    if any(has_token(dest, "nearer_to") for dest in question.find_data("beside")):  # than what?
        said.lack(RequestProblemKind.SENTENCE, question)
    match str(question.data), parts:
        case "ask_state", [objects, state]:
            slot = Slot(read_lexicon()["meanings"][state.data]["slot"])
            kind, names = _resolve(said, objects, slot)
            statements = _say_state(said, names, state)
        case "ask_which_state", [plain, state]:
            slot = Slot(read_lexicon()["meanings"][state.data]["slot"])
            statements = _say_state(said, said.list_alike(plain, slot), state)
        case "ask_place", [objects, *dests]:
            kind, names = _resolve(said, objects, Slot.ANY)
            statements = _say_places(said, names, dests)
        case "ask_contains", [owner, objects]:
            kind, names = _resolve(said, objects, Slot.ANY)
            statements = said.list_placed(names, Node("into", [owner]))
        case "ask_which", [*nouns, dest]:
            kind = InquiryKind.SIDE if dest.data in {*SIDES, "under"} else kind
            statements = _say_which(said, nouns, dest)
        case "ask_count", [plain, *dest] if said.is_loose(plain):
            kind, statements = InquiryKind.CONTENTS, _list_contents(said, dest)
        case "ask_count", [plain, *dest]:
            some = said.list_alike(plain)
            statements = said.list_placed(some, dest[0]) if dest else dict.fromkeys(some, "")
        case "ask_compare", [plain, *_] if plain.data == "plain":
            said.heads[Slot.MOVED] = said.find_head(plain)
            return read_inquiry(said, Node(question.data, [*parts[1:]]))
        case "ask_compare", [size, *nouns]:
            others = [noun for noun in nouns if noun.data != "reference"]
            near = [part for noun in nouns if noun.data == "reference" for part in list_children(noun)]
            statements = dict.fromkeys(_compare(said, size, others, near)[1], "")
        case "ask_whether_more", [one, size, *reference, other]:
            names, most = _compare(said, size, (one, other), reference)
            statements = {names[0]: ", ".join(most)} if len(names) == 2 else {}
            if len(names) != 2 and not said.questions:
                said.lack(RequestProblemKind.SENTENCE, question)
        case "ask_named", [*nouns, last]:
            statements = dict.fromkeys(said.list_most(nouns, last), "")
        case data, _ if data in _OF_PARTS:
            kind, statements = _read_parts(said, question, parts)
        case _, [objects]:
            statements = dict.fromkeys(said.resolve(objects, Slot.ANY).names, "")
    if has_token(question, "untrue"):
        statements = {name: f"not ({text})" for name, text in statements.items()}
    return Inquiry(kind=kind, words=said.text.strip(" ;"), statements=statements)


def _read_parts(said: Clauses, question: Node, parts: Sequence[Node]) -> tuple[InquiryKind, dict[str, str]]:
    """How many parts something has, which of two is in a state or nearer, in which of two states, whether alike."""
    kind, statements = _KINDS[question.data], dict[str, str]()
    match str(question.data), parts:
        case "ask_holder", [plain, noun]:
            statements = said.list_holding(said.list_alike(plain, Slot.PLACE), said.resolve_one(noun, Slot.ANY).names)
        case "ask_parts", [plain, owner]:
            owners = said.resolve_one(owner, Slot.ANY).names
            statements = dict.fromkeys(said.list_owned(plain, owners), "")
            if said.is_loose(plain):
                kind, statements = InquiryKind.CONTENTS, {name: f"contains({name})" for name in owners}
        case "ask_which_of", [state, *nouns]:
            slot = Slot(read_lexicon()["meanings"][state.data]["slot"])
            statements = _say_state(
                said, [name for noun in nouns for name in said.resolve_one(noun, slot).names], state
            )
        case "ask_distance", _:
            *names, other = said.resolve(question, Slot.ANY).names or ("",)
            statements = {name: f"near({name}, {other})" for name in names}
        case "ask_height", [noun]:
            heights = {name: 2 * said.get(name).half_m[2] for name in said.resolve_one(noun, Slot.ANY).names}
            statements = {name: format_length(m) if m else _WORDS[Truth.UNKNOWN] for name, m in heights.items()}
        case "ask_pair", [plain]:
            kind = InquiryKind.FARTHER if has_token(question, "farthest_pair") else kind
            names = said.list_alike(plain)
            statements = {f"{one} and {other}": f"near({one}, {other})" for one, other in combinations(names, 2)}
            if len(names) < 3:  # nothing to choose from
                said.lack(RequestProblemKind.OBJECT, plain, names)
        case "ask_states", [objects, *states]:
            for state in states:
                slot = Slot(read_lexicon()["meanings"][state.data]["slot"])
                texts = _say_state(said, said.resolve(objects, slot).names, state)
                statements |= {f"{name} {said.quote(state)}": text for name, text in texts.items()}
        case "ask_nearer", [noun, *others]:
            kind = InquiryKind.FARTHER if has_token(question, "far_from") else kind
            names = [*said.resolve_one(noun, Slot.ANY).names]
            places = [name for other in others for name in said.resolve_one(other, Slot.ANY).names]
            statements = {place: f"near({name}, {place})" for name in names for place in places}
            if not said.questions and (len(names) != 1 or len(statements) < 2 or names[0] in places or said.chosen):
                said.lack(RequestProblemKind.SENTENCE, question)
        case "ask_same", [objects]:
            bodies = [said.get(name) for name in said.resolve(objects, Slot.ANY).names]
            most = list_most(bodies, "large", 1.0, None)
            statements = {", ".join(each.name for each in bodies): ", ".join(most)}
    return kind, statements


def _say_places(said: Clauses, names: Iterable[str], dests: Sequence[Node]) -> dict[str, str]:
    """Of each object, that it is at one of these places; `in A or B` is two of them."""
    each_at = (Node(dests[0].data, [each]) if each.data == "quantified" else each for each in dests)
    placed = [said.list_placed(names, each) for each in each_at]
    return {name: " or ".join(each[name] for each in placed if name in each) for name in placed[0]}


def _compare(said: Clauses, size: Node, nouns: Iterable[Node], near: Iterable[Node]) -> tuple[list[str], list[str]]:
    """The objects that phrases mean, and those of them that are most so, or nearest to or farthest from another one."""
    names, owners = (
        [name for noun in each for name in said.resolve_one(noun, Slot.ANY).names] for each in (nouns, near)
    )
    at_m = next((said.get(owner).at_m for owner in owners), None)
    return names, list_most([said.get(name) for name in names], str(size.data), 1.0, at_m)


def _resolve(said: Clauses, objects: Node, slot: Slot) -> tuple[InquiryKind, Iterable[str]]:
    """The objects that a question is about, and what it wants to know: of `a cube`, of how many it is so.

    A question chooses none of several, as a goal does.
    """
    (first, *_) = list_children(objects)
    if first.data == "everything" and str(first.children[0]) == "anything":
        return InquiryKind.COUNT, [name for name in said.resolve(objects, slot).names if said.get(name).movable]
    left_open = [noun for noun in list_children(objects) if any(find_child(noun, each) for each in _OPEN)]
    if not left_open:
        return InquiryKind.WHETHER, said.resolve(objects, slot).names
    if len(list_children(objects)) > 1:
        return InquiryKind.WHETHER, said.lack(RequestProblemKind.SENTENCE, objects)
    return InquiryKind.COUNT, said.list_alike(list_children(left_open[0])[-1], slot)


def _list_contents(said: Clauses, dest: Iterable[Node]) -> dict[str, str]:
    """Of each vessel of a destination, or of all that hold any, the statement that something is in it."""
    places = [name for each in dest for name in said.find_any_places(each)]
    return {name: f"contains({name})" for name in places or [each.name for each in said.list_fitting(Slot.LOOSE)]}


def _say_which(said: Clauses, nouns: Sequence[Node], dest: Node) -> dict[str, str]:
    """Of each object of a noun, or of all, that it is at a place; `what is in the cup` may be balls without names."""
    some = said.list_alike(nouns[0]) if nouns else [each.name for each in said.list_fitting(Slot.MOVED)]
    if dest.data in {*SIDES, "under"}:
        return said.list_beside(some, dest)
    vessels = [] if nouns else [name for name in said.find_any_places(dest) if said.get(name).contents]
    return said.list_placed(some, dest) | {f"balls in {name}": f"contains({name})" for name in vessels}


def _say_state(said: Clauses, names: Iterable[str], state: Node) -> dict[str, str]:
    if read_lexicon()["meanings"][state.data]["slot"] == Slot.OPENS:
        names = [said.find_opening(name) for name in names]
    return {name: said.say_state(said.get(name), str(state.data)) for name in names}


_OPEN = ("any", "number", "exactly", "half", "some")  # quantities that leave open which objects are meant
_OF_PARTS = {  # read by their parts
    *(
        "ask_distance",
        "ask_parts",
        "ask_which_of",
        "ask_same",
        "ask_states",
        "ask_nearer",
        "ask_height",
        "ask_pair",
        "ask_holder",
        "ask_why",
    )
}
_KINDS = {
    "ask_state": InquiryKind.WHETHER,
    "ask_place": InquiryKind.WHETHER,
    "ask_contains": InquiryKind.WHETHER,
    "ask_where": InquiryKind.WHERE,
    "ask_which": InquiryKind.WHICH,
    "ask_holder": InquiryKind.WHICH,
    "ask_which_state": InquiryKind.WHICH,
    "ask_named": InquiryKind.WHICH,
    "ask_compare": InquiryKind.WHICH,
    "ask_whether_more": InquiryKind.COMPARED,
    "ask_same": InquiryKind.COMPARED,
    "ask_count": InquiryKind.COUNT,
    "ask_parts": InquiryKind.COUNT,
    "ask_which_of": InquiryKind.WHICH,
    "ask_states": InquiryKind.WHICH,
    "ask_nearer": InquiryKind.NEARER,
    "ask_distance": InquiryKind.DISTANCE,
    "ask_height": InquiryKind.HEIGHT,
    "ask_pair": InquiryKind.NEARER,
    "ask_colour": InquiryKind.COLOUR,
    "ask_why": InquiryKind.WHY,
    "ask_abilities": InquiryKind.ABILITIES,
}


def answer(inquiry: Inquiry, world: Environment) -> Answer:
    """The answer of a snapshot to a question about it; why, and what can be wished for, it does not know."""
    if inquiry.kind in {InquiryKind.SIDE, InquiryKind.HEIGHT}:
        return Answer(answer="; ".join(f"{who}: {names}" for who, names in inquiry.statements.items()))
    if inquiry.kind is InquiryKind.COMPARED:
        ((name, most),) = inquiry.statements.items()
        is_more = most == name
        return Answer(answer=_WORDS[Truth.TRUE if is_more else Truth.FALSE], evidence=(f"the most so: {most}",))
    found = {name: _evaluate(text, world) for name, text in inquiry.statements.items() if text}
    evidence = tuple(f"{inquiry.statements[name]} is {each.truth}: {each.because}" for name, each in found.items())
    true = [name for name in inquiry.statements if name not in found or found[name].truth is Truth.TRUE]
    unknown = [name for name, each in found.items() if each.truth is Truth.UNKNOWN]
    match inquiry.kind:
        case InquiryKind.WHETHER:
            worst = min(found.values(), key=lambda each: each.order)
            texts = [inquiry.statements[name] for name, each in found.items() if each is worst]
            is_partly = worst.truth is Truth.FALSE and any(_is_between(text, world) for text in texts)
            return Answer(answer=f"partly: {worst.because}" if is_partly else _WORDS[worst.truth], evidence=evidence)
        case InquiryKind.CONTENTS:
            return Answer(answer="; ".join(_count(name, each) for name, each in found.items()), evidence=evidence)
        case InquiryKind.NEARER | InquiryKind.FARTHER:
            return Answer(answer=_choose(found, is_farther=inquiry.kind is InquiryKind.FARTHER), evidence=evidence)
        case InquiryKind.DISTANCE:
            apart = {
                name: format_length(float(each.measured["distance_m"])) for name, each in found.items() if each.measured
            }
            lines = (f"{name} is {apart.get(name, 'at an unknown distance')} away" for name in found)
            return Answer(answer="; ".join(lines), evidence=evidence)
        case InquiryKind.WHERE:
            return Answer(answer="; ".join(_locate(name, world) for name in inquiry.statements))
        case InquiryKind.COLOUR:
            known = (world.entities[name] for name in inquiry.statements if name in world.entities)
            return Answer(answer="; ".join(f"{each.name} is {each.color or 'of no known colour'}" for each in known))
    counted = {name: _count(name, found[name]) for name in true if _says_count(inquiry.statements[name])}
    partly = [
        name
        for name, each in found.items()
        if each.truth is Truth.FALSE and _is_between(inquiry.statements[name], world)
    ]
    parts = [", ".join(counted.get(name, name) for name in true) or ("" if unknown or partly else "nothing")]
    parts += [f"partly {', '.join(partly)}"] if partly else []
    parts += [f"unknown of {', '.join(unknown)}"] if unknown else []
    listed = "; ".join(filter(None, parts))
    is_count = inquiry.kind is InquiryKind.COUNT
    return Answer(answer=f"{len(true)}: {listed}" if is_count else listed, evidence=evidence)


def _choose(found: Mapping[str, Evaluation], *, is_farther: bool) -> str:
    """The nearest, or the farthest, with how far each is away; unknown where one distance is."""
    apart = {name: float(each.measured["distance_m"]) for name, each in found.items() if each.measured}
    if len(apart) < len(found):
        return _WORDS[Truth.UNKNOWN]
    one, *others = sorted(apart, key=apart.__getitem__, reverse=is_farther)
    written = {name: format_length(apart[name]) for name in (one, *others)}
    is_alike = written[one] == written[others[0]]
    return "; ".join(
        (
            f"{'equally far' if is_alike else one}: {one} is {written[one]} away",
            *(f"{each} is {written[each]} away" for each in others),
        )
    )


def _says_count(text: str) -> bool:
    return bool(text) and says(text, Meaning.CONTAINS)


def _is_between(text: str, world: Environment) -> bool:
    """Whether a state is not so, and none that excludes it either, as of a drawer that is open by half."""
    opposites = list_flipped(text)
    return bool(opposites) and all(_evaluate(each, world).truth is Truth.FALSE for each in opposites)


def _evaluate(text: str, world: Environment) -> Evaluation:
    return parse_predicate(text).evaluate(View(now=world, initial=world))


def _count(name: str, found: Evaluation) -> str:
    least, most = (found.measured.get(each) for each in ("least", "most"))
    return f"{name}: {'unknown' if least is None else least if least == most else f'{least} to {most}'}"


def _locate(name: str, world: Environment) -> str:
    if (entity := world.entities.get(name)) is None:
        point_m = world.regions[name].pose.position_m
        return f"{name} is a region around {_write(point_m)} m"
    places = ", ".join(f"{each.name} {each.arguments[-1]}" for each in find_places(entity, world))
    held = f"held by {entity.held_by}" if entity.held_by else ""
    return f"{name} is {held or places or 'fixed'}, at {_write(entity.pose.position_m)} m"


def _write(point_m: tuple[float, ...]) -> str:
    return f"({', '.join(f'{each:.2f}' for each in point_m)})"
