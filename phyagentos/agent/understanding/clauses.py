"""What clauses mean: each becomes predicates that shall come true, or that must hold all through.

Upstream: a reading. Downstream: the embedded understander. One method a rule of the grammar; rules that say the same of
each object stand in the lexicon. Clauses are steps where the request says an order, or where they exclude each other.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from lark import Tree

from phyagentos.agent.understanding.bearings import is_tall, is_within
from phyagentos.agent.understanding.discourse import Named, Slot
from phyagentos.agent.understanding.followups import FollowUps
from phyagentos.agent.understanding.keeping import ACTS
from phyagentos.agent.understanding.phrases import Node, find_child, find_side, get_type, has_token, list_children
from phyagentos.agent.understanding.steps import Step, get_object, list_flipped, negate, rename, says
from phyagentos.agent.understanding.understanding import QuestionKind, RequestProblemKind
from phyagentos.agent.understanding.vocabulary import REGION, ROLE, read_lexicon
from phyagentos.protocol.predicates.library import Meaning
from phyagentos.protocol.predicates.predicate import find_entities


@dataclass(slots=True, kw_only=True)
class Clauses(FollowUps):
    """Predicates of a plan, collected clause by clause.

    Attributes:
        _leads: Whether a clause is the first of its step.
    """

    _wiped: str = ""
    _leads: bool = True

    def read_plan(self, plan: Node) -> list[Step]:
        """The steps of a plan in the order in which they have to come true."""
        parts, others = list_children(plan), list[Node]()
        if plan.data == "in_case":
            (case,) = (part for part in parts if part.data != "group")
            parts.remove(case)
            count, asked = len(self.lacks), len(self.questions)
            self._check_case(case)
            if has_token(plan, "otherwise"):
                is_unmet = {each.kind for each in self.lacks[count:]} == {RequestProblemKind.UNMET}
                del self.lacks[count if is_unmet else len(self.lacks) :]
                if is_unmet:  # `it` is what the other part is about
                    self.resolve(next(parts[0].find_data("things")), Slot.ANY)
                    del self.questions[asked:]
                    self.recent.append([])
                parts, others = (parts[1:], parts[:1]) if is_unmet else (parts[:1], parts[1:])
        read = [self._read_group(part) if part.data == "group" else self._read_steps(part) for part in parts]
        steps = [step for group in (reversed(read) if plan.data == "reversed" else read) for step in group if step]
        wanted, asked, count = [text for step in steps for text in step], len(self.questions), len(self.lacks)
        for plain in (each for part in others for each in part.find_data("plain")):
            self._find_candidates(plain, Slot.ANY, "")  # heard, and not to be done
        del self.questions[asked:], self.lacks[count:]
        return [[each for text in step for each in self._spare(text, wanted)] for step in steps]

    def _check_case(self, case: Node) -> None:
        """A condition is of the world as it is now: where it holds it is no part of the goal."""
        if case.data == "exists":
            plain, *dest = list_children(case)
            names = self.list_alike(plain, Slot.ANY)
            if dest:
                there = self.list_placed(names, dest[0])
                names = [name for name in there if self.vocabulary.is_known(there[name], is_true=True)]
            self.recent[-1] += names
            if not names:
                self.lack(RequestProblemKind.UNMET, case)
            return
        texts, is_untrue = self._read_texts(case), has_token(case, "untrue")
        self.moved, self.placed, self.unmet = [], (), ""
        if not all(texts) or not texts or any(says(text, Meaning.AT) for text in texts):  # a side is more than a point
            self.lack(RequestProblemKind.CONDITION, f"if {self.quote(case)}")
            return
        for text in texts:
            # a drawer may be neither open nor closed: it is not what `closed` says, and no more is known
            known, flipped = self.vocabulary.is_known, list_flipped(text)
            is_ajar = bool(flipped) and all(known(each, is_true=False) for each in (text, *flipped))
            is_undecided = is_ajar and (is_untrue or not says(text, Meaning.CLOSED))
            if not is_undecided and known(text, is_true=is_untrue):
                self.lack(RequestProblemKind.UNMET, case)
            elif is_undecided or not known(text, is_true=not is_untrue):
                self.lack(RequestProblemKind.CONDITION, f"if {self.quote(case)}")
        self.reasons.append(f"{self.quote(case)}: so it is as the scene begins")

    def _spare(self, text: str, wanted: Step) -> Step:
        """A predicate; of `nothing on the table` one each, where something is to be left or put there."""
        relation, is_all, place = text.removeprefix("not ").partition("(*, ")
        if not is_all:
            return [text]
        left = {get_object(each) for each in self.constraints if says(each, Meaning.MOVED, is_true=False)}
        left.update(self.exempt)
        put = {
            get_object(each)
            for each in (*self.constraints, *wanted)
            if re.fullmatch(rf"{relation}\(\w+, {re.escape(place)}", each)
        }
        standing = [each.name for each in self._list_standing(self.list_fitting(Slot.MOVED), find_entities(text))]
        if not put and left.isdisjoint(standing):
            return [text]
        return [text.replace("*", name) for name in standing if name not in left | put]

    def _read_group(self, group: Node) -> list[Step]:
        """One step, or one a clause where these exclude each other."""
        clauses = self._list_steps(group)
        flipped = {each for step in clauses[1:] for text in step for each in (*list_flipped(text), negate(text))}
        if any(text in flipped for step in clauses for text in step) or any(
            find_child(group, each) is not None for each in ("first_of", "ordered")
        ):
            return clauses
        return [[text for step in clauses for text in step]]

    def _list_steps(self, group: Node) -> list[Step]:
        """The steps of each clause, without what a later one says otherwise.

        What is picked up and then named again is not held in the end; what is `left` is none of `the cubes`.
        """
        steps: list[Step] = []
        count = 0
        topic, *others = list_children(group)
        is_apart = "and" not in map(str, group.children[group.children.index(topic) + 1 :][:1])
        is_topic = topic.data == "elided" and others and is_apart and not self._verb and not self.list_past()
        named = self.resolve(list_children(topic)[0], Slot.ANY).names if is_topic else ()  # `the red cube, put it ...`
        for clause in others if is_topic else [topic, *others]:
            self._leads = clause is topic
            read = self._read_steps(clause)
            self._ask_scope(group, clause, read)
            self._check_meanwhile(group, clause, read)
            if clause.data == "anew":  # `open the drawer, no, close it` takes back the clause before
                del steps[len(steps) - count :]
            count = len(read)
            again = {f"holding({ROLE}, {name})" for name in self.recent[-1]} if any(read) else set()
            steps = [[text for text in step if text not in again] for step in steps] + read
        texts = [text for step in steps for text in step]
        about = {name for text in (*texts, *self.constraints) for name in find_entities(text)}
        if (
            named and not self.questions and about.isdisjoint((*named, *map(self.find_opening, named)))
        ):  # what is said of it is not known
            self.lack(RequestProblemKind.SENTENCE, topic)
        opened = {get_object(text) for text in texts if says(text, Meaning.OPEN, Meaning.CLOSED)}
        held = {text: self.get(get_object(text)) for text in texts if says(text, Meaning.HOLDING)}
        grips = {text for text, each in held.items() if not each.movable and self.find_opening(each.name) in opened}
        self.unsaid += sorted(grips)  # `grab the handle and pull the door open`
        steps = [[text for text in step if text not in grips] for step in steps]
        still = {get_object(text) for text in self.constraints if says(text, Meaning.MOVED, is_true=False)}
        kept = [[text for text in step if get_object(text) not in still & self.grouped] for step in steps]
        return [*kept] if any(kept) else steps

    def _ask_scope(self, group: Node, clause: Node, read: Sequence[Step]) -> None:
        """Whether `do not open the drawer and put the cube into it` forbids both, as they are about the same."""
        at = group.children.index(clause)
        *_, before, joined = ["", "", *group.children[:at]]
        if joined != "and" or not isinstance(before, Tree) or not before.data.startswith("never"):
            return
        is_said = not any(has_token(before, each) for each in ("must_not", "leave"))
        is_first = get_type(group.children[at - 3] if at > 2 else "") != "without"
        kept, wanted = (
            {name for text in texts for name in find_entities(text)}
            for texts in (self.constraints, [text for step in read for text in step])
        )
        if is_said and is_first and kept & wanted and not clause.data.startswith(("never", "keep")):
            both, one = "neither is wanted", "this is wanted"
            if self.ask(QuestionKind.READING, clause, (one, both)) == (both,):
                self.lack(RequestProblemKind.GOAL, clause)

    def _check_meanwhile(self, group: Node, clause: Node, read: Sequence[Step]) -> None:
        """`while holding the bottle` is no end, and nothing else can be held meanwhile."""
        joined = str(group.children[group.children.index(clause) - 1])
        if joined.endswith("while") and any(says(text, Meaning.HOLDING) for step in read for text in step):
            self.lack(RequestProblemKind.CAPABILITY, clause)

    def _read_steps(self, clause: Node) -> list[Step]:
        """The steps of one clause: of `open and close the drawer` two."""
        if self.recent[-1]:
            self.recent.append([])
        if clause.data == "state_command":
            *acts, objects = list_children(clause)
            self._verb = str(acts[-1].data)
            steps = [self._say(str(act.data), objects) for act in acts]
        elif clause.data == "series":  # objects in an order, and one destination
            *series, dest = list_children(clause)
            steps = [self._read_wish_place(clause, objects, dest) for objects in series]
        elif clause.data == "ordered":
            steps = [[text] for text in self._read_texts(list_children(clause)[0])]
        elif clause.data == "first_of":  # of what a command is about one before the others
            command, single = list_children(clause)
            if command.data == "heap":  # which one is first or last is its place in the tower
                self.lack(RequestProblemKind.SENTENCE, single)
            texts = self._read_texts(command)
            names = self.resolve_one(single, Slot.OPENS if self._verb in ACTS else Slot.MOVED).names
            is_first = has_token(clause, "first") or has_token(clause, "beginning")
            steps = [[text for text in texts if (get_object(text) in names) is is_first], texts]
            if len(steps[0]) in {0, len(texts)}:
                self.lack(RequestProblemKind.SENTENCE, single)
        elif clause.data in read_lexicon()["meanings"]:
            self._verb = str(clause.data)
            if has_token(clause, "leave") and any(
                clause.find_data("located")
            ):  # `leave the mug on the table` says where
                self.lack(RequestProblemKind.SENTENCE, clause)
            steps = [self._say(str(clause.data), list_children(clause)[0])]
        else:
            read: Callable[..., Step] = getattr(self, f"_read_{clause.data}")
            steps = [read(clause, *list_children(clause))]
        self._said += [text for step in steps for text in step]
        lying = any(get_type(each) == "put" and str(each).startswith("lay") for each in clause.children)
        if lying and any(is_tall(self.get(name)) for name in self.placed):  # `lay the bottle down`: another posture
            self.lack(RequestProblemKind.CAPABILITY, clause)
        if self.unmet:  # `only`, `exactly` and `of its colour` are understood of what is put somewhere
            self.lack(RequestProblemKind.SENTENCE, self.unmet)
        return steps

    def _read_texts(self, clause: Node) -> Step:
        return [text for step in self._read_steps(clause) for text in step]

    # what leaves open where to, or what

    def _read_unplaced(self, clause: Node, objects: Node) -> Step:
        """`move the box`: a question where to; of what has a joint, whether to open or to close it."""
        names = self.resolve(objects, Slot.ANY).names
        if names and not any(self.get(name).movable for name in names):
            if not all(self.get(self.find_opening(name)).opens for name in names):
                return self.lack(RequestProblemKind.FIXED, clause)
            return [text for verb in self.ask(QuestionKind.DEED, clause, ACTS[:2]) for text in self._say(verb, objects)]
        places = [each.name for each in self.list_rests()]
        into = [name for name in names if name in places]
        if "," in self.quote(clause) and len(into) == 1 < len(names):  # `blue cube, red tray`
            put = self._put(Named(names=tuple(name for name in names if name not in into)))
            return [self._relate(name, into[0]) for name in put]
        chosen = self.ask(QuestionKind.WHERE, clause, places) if names else ()
        return [self._relate(name, place) for place in chosen for name in self._put(Named(names=names))]

    def _read_bare_act(self, clause: Node, act: Node) -> Step:
        """`close`: the one object that can be, or a question which."""
        kinds = read_lexicon()["meanings"][act.data].get("kinds")
        fitting = [each for each in self.list_fitting(Slot.OPENS) if act.data != "press" or each.opens == "slide"]
        fitting = [each for each in fitting if kinds is None or each.kind in kinds]
        names = tuple(each.name for each in fitting)
        chosen = names if len(names) == 1 else self.ask(QuestionKind.WHICH, clause, names)
        return [read_lexicon()["meanings"][act.data]["form"].format(name) for name in chosen]

    # placing

    def _read_by_means(self, _: Node, *parts: Node) -> Step:
        """A goal says what is true then, and not with what: which of several handles it is stays open."""
        tool, command = sorted(parts, key=lambda part: part.data != "things")
        alike = [name for plain in tool.find_data("plain") for name in self.list_alike(plain, Slot.ANY)]
        self.recent[-1] += alike if len(alike) == 1 else self.resolve(tool, Slot.ANY).names if not alike else ()
        self.unsaid.append(f"with {self.quote(tool)}")
        return self._read_texts(command)

    def _read_go_on(self, _: Node, objects: Node) -> Step:
        """`drive to the bay and then to the dock`."""
        return self._say("go", objects) if self._verb == "go" else self.lack(RequestProblemKind.SENTENCE, objects)

    def _read_anew(self, _: Node, command: Node) -> Step:
        """`actually, put it into the blue tray`."""
        return self._read_texts(command)

    def _read_once_more(self, clause: Node, command: Node) -> Step:
        """What was undone, or left, since; what is true still cannot come true twice."""
        said = {get_object(text): text for text in self._said}
        texts = self._read_texts(command)
        if any(said.get(get_object(text)) == text for text in texts):
            return self.lack(RequestProblemKind.CAPABILITY, clause)
        return texts

    def _read_elided(self, clause: Node, objects: Node) -> Step:
        """`press the green button and then the red one`: the verb is that of the clause, or of the goal, before."""
        before = self.list_past()
        if not self._verb and before and any(objects.find_data("only")):
            return self._read_only(objects)
        if not self._verb and before and (has_token(clause, "same_with") or len(self.recent) == 1):
            self.again = True
            last = [text for text in self.vocabulary.past[-1].accept if get_object(text) == before[-1]]
            names = self._resolve_after(before, objects)
            names = tuple(map(self.find_opening, names)) if self.get(before[-1]).opens else names
            return [rename(text, {before[-1]: name}) for name in names for text in last]
        is_same = has_token(clause, "same_with")
        if is_same and not before and not self._verb:
            return self.lack(RequestProblemKind.PAST, clause)
        if not self._verb and len(self.recent) == 1:
            return self._read_unplaced(clause, objects)
        if self._verb == "put" and (self._leads or is_same):  # `put the can into the tray, then the cube`
            return self._read_same_place(clause, objects)
        return self._say(self._verb, objects) if self._verb in ACTS else self.lack(RequestProblemKind.SENTENCE, clause)

    # doing other objects

    def _read_pick(self, clause: Node, objects: Node, *_: Node) -> Step:
        source = find_child(clause, "source")
        self.placed = self._resolve_from(objects, source).names
        if source is not None and len(self.placed) > 1:
            return self.lack(RequestProblemKind.SENTENCE, clause)
        lifts = {name for name in self.placed if has_token(clause, "lift") and self.get(name).opens == "hinge"}
        return [f"open({name})" if name in lifts else f"holding({ROLE}, {name})" for name in self.placed]

    def _read_pour(self, clause: Node, *parts: Node) -> Step:
        objects, source = find_child(clause, "things"), find_child(clause, "source")
        if (
            objects is not None
            and has_token(clause, "fill")
            and not any(map(self.is_loose, objects.find_data("plain")))
        ):
            place = self.resolve_one(parts[0], Slot.VESSEL).names
            return [self._relate(name, at) for name in self._put(self.resolve(objects, Slot.MOVED)) for at in place]
        poured = self.resolve(objects, Slot.LOOSE) if objects is not None else Named()
        if has_token(clause, "fill") and objects is None:  # `fill the bowl`: from the one vessel that holds any
            full = [each.name for each in self.list_fitting(Slot.LOOSE)]
            poured = Named(names=tuple(full)) if full else Named(names=self.lack(RequestProblemKind.FIT, clause))
        if objects is None and source is None and not poured.names:
            return []
        if source:
            poured = replace(poured, names=self.resolve_one(list_children(source)[0], Slot.VESSEL).names)
        into = next(each for each in parts if each.data not in {"things", "source"})
        return self._fill(clause, poured, self.resolve_one(into, Slot.VESSEL).names)

    def _read_pour_out(self, clause: Node, objects: Node, *source: Node) -> Step:
        """Into the one other vessel, or a question."""
        if not all(self.is_loose(plain) for plain in objects.find_data("plain")):
            return self.lack(RequestProblemKind.SENTENCE, clause)
        poured = self.resolve(objects, Slot.LOOSE)
        return self._fill(clause, poured, self._find_receivers(clause, *poured.names))

    def _read_wipe(self, clause: Node, objects: Node, *tools: Node) -> Step:
        for tool in tools:  # a goal says what is clean then, and not with what
            self.resolve_one(tool, Slot.MOVED)
            self.unsaid.append(f"with {self.quote(tool)}")
        named = self.resolve(objects, Slot.VESSEL)
        names = named.names
        gone: Sequence[str] = ("*",)
        if named.rest and not any(self.get(name).kind == REGION for name in names):  # `only the red crumb`
            self.unmet = ""
            self._keep(f"not moved({name})" for name in named.rest)
        if any(self.get(name).kind != REGION for name in names):
            regions = [each for each in self.list_fitting(Slot.ANY) if each.kind == REGION]
            if not regions:
                return self.lack(RequestProblemKind.CAPABILITY, clause)
            soiled = [each.name for each in regions if all(is_within(self.get(name), each) for name in names)]
            gone = names if len(soiled) == 1 else gone  # `wipe up the crumbs`: where they lie
            kind = QuestionKind.WHICH if len(regions) > 1 else QuestionKind.WHERE
            single = tuple(soiled) if len(soiled) == 1 else ()
            names = single or self.ask(kind, objects, [each.name for each in regions])
        self._wiped = names[0] if len(names) == 1 else ""
        return [f"not inside({each}, {name})" for name in names for each in gone]

    def _read_tower(self, clause: Node, *parts: Node) -> Step:
        levels = [part for part in parts if part.data == "level"]
        bases = [part for part in parts if part.data != "level"]
        on = self.resolve_one(bases[0], Slot.PLACE).names if bases else ()
        named = [self.resolve_one(list_children(level)[0], Slot.MOVED).names for level in levels]
        names = [each[0] for each in named if len(each) == 1]
        lowest, highest = (find_side(levels, f"side_{side}") for side in ("bottom", "top"))
        rises = has_token(clause, "from_bottom") or 0 in lowest or -1 in highest
        is_chain = has_token(clause, "onto") and not bases  # `red on green on blue`
        sinks = is_chain or has_token(clause, "from_top") or 0 in highest or -1 in lowest
        if rises is sinks:
            orders = [f"from below: {', '.join(each)}" for each in (names, names[::-1])] if names else []
            answer = self.ask(QuestionKind.ORDER, clause, orders)
            sinks = answer == tuple(orders[1:])
            names = names if answer else []
        names = names[::-1] if sinks else names
        self.placed = tuple(names[-1:])
        steps = pairwise([*on, *names]) if len(named) == len(names) else ()
        return [self._relate(upper, lower) for lower, upper in steps]

    def _read_pose(self, clause: Node) -> Step:
        posture = next(str(token) for token in clause.children if get_type(token) == "posture")
        return [f"in_posture({ROLE}, {'_'.join(posture.split())})"]

    # states that are wished for, or reached

    def _read_wish_not_state(self, _: Node, objects: Node, state: Node) -> Step:
        """`do not leave the drawer open`."""
        return [each for text in self._say(str(state.data), objects) for each in list_flipped(text) or [negate(text)]]

    def _read_wish_state(self, _: Node, objects: Node, state: Node) -> Step:
        self._verb = self._verb or "put"  # `the bottle upright, the cubes in the tray`
        return self._say(str(state.data), objects)

    def _read_wish_holds(self, clause: Node, vessel: Node, objects: Node) -> Step:
        """`the tray should contain the two bars`, and nothing else where it says `only`."""
        if any(self.is_loose(plain) for plain in objects.find_data("plain")):
            return self._read_wish_contains(clause, vessel, list_children(objects)[0])
        names, places = self.resolve(objects, Slot.MOVED).names, self.resolve_one(vessel, Slot.PLACE).names
        others = [each.name for each in self.list_fitting(Slot.MOVED) if each.name not in names]
        gone = others if has_token(clause, "only") else []
        wanted = [self._relate(name, place) for name in self._put(Named(names=names)) for place in places]
        return [*wanted, *(f"not {self._relate(name, place)}" for name in gone for place in places)]

    def _read_wish_contains(self, clause: Node, *parts: Node) -> Step:
        loose, vessel = parts if has_token(clause, "there") else parts[::-1]
        names = self.resolve_one(vessel, Slot.VESSEL).names
        if not (number := self.resolve_one(loose, Slot.LOOSE).number):
            self.ask(QuestionKind.HOW_MANY, loose, ())
        return [f"contains({name}, {number})" for name in names]

    def _read_vacant(self, _: Node, objects: Node) -> Step:
        return self._say("clear", objects)

    def _read_emptied(self, clause: Node, gone: Node, *places: Node) -> Step:
        objects = self.resolve_one(gone, Slot.MOVED, forbids=True).names
        where = self.resolve_one(places[0], Slot.PLACE).names if places else (self._wiped,) * bool(self._wiped)
        if not where:
            self.lack(RequestProblemKind.SENTENCE, clause)
        return [f"not {self._relate(name, at)}" for at in where for name in objects]

    def _read_stand_at(self, _: Node, objects: Node, dest: Node) -> Step:
        return [*self._say("stand", objects), *self._read_wish_place(dest, objects, dest)]

    def _read_until(self, _: Node, command: Node, condition: Node) -> Step:
        done, until = self._read_texts(command), self._read_texts(condition)
        about, named = ({name for text in texts for name in find_entities(text)} for texts in (done, until))
        if about.isdisjoint(named):  # until something else is so: for a time
            return self.lack(RequestProblemKind.SENTENCE, condition)
        filled = {get_object(text) for text in until if says(text, Meaning.CONTAINS)}
        return [
            *(each for each in done if not says(each, Meaning.CONTAINS) or get_object(each) not in filled),
            *until,
        ]
