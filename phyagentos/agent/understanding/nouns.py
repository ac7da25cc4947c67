"""What noun phrases mean: `every cube except the red one`, `it`, `the rest`, `two of them`, `the tray of its colour`.

Upstream: a reading. Downstream: the clauses. What is open becomes a question with its candidates, what is not here a
lack; a phrase is never taken for the nearest object.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from phyagentos.agent.understanding.bearings import SIDES, list_most
from phyagentos.agent.understanding.discourse import Discourse, Named, Slot, read_adjectives
from phyagentos.agent.understanding.phrases import (
    Node,
    find_child,
    get_type,
    has_token,
    is_open,
    list_children,
    read_number,
)
from phyagentos.agent.understanding.understanding import QuestionKind, RequestProblemKind

_RANKS = {"large", "small", "tall", "long"}
_CHOOSING = {*SIDES, "near", "far", "middle", "top", "bottom"}


@dataclass(slots=True, kw_only=True)
class Nouns(Discourse):
    """The objects that phrases mean, with their quantities, exceptions and pronouns."""

    def resolve(self, objects: Node, slot: Slot, *, forbids: bool = False) -> Named:
        """The objects of a list of phrases; `forbids` where it says what must not be, so that `a cube` is every one."""
        parts = [child for child in list_children(objects) if child.data != "except"]
        is_pair = len(parts) == 2 and any(parts[0].find_data("both"))  # `both the red and the green cube`
        named = self._resolve_parts(parts, slot, forbids=forbids, is_pair=is_pair)
        if len(parts) == 2 and (size := self._find_size(parts[0])):
            bodies = [self.get(name) for each in named for name in each.names]
            chosen = list_most(bodies, size, 1.0, None)
            named = [Named(names=tuple(chosen) if len(chosen) == 1 else self.ask(QuestionKind.WHICH, objects, chosen))]
        if slot is Slot.LOOSE and len(named) > 1:  # two numbers are no one number
            self.lack(RequestProblemKind.SENTENCE, objects)
        names = tuple(dict.fromkeys(name for each in named for name in each.names))
        if len(names) < len(named) == sum(len(each.names) for each in named):  # one object is no two
            self.ask(QuestionKind.WHICH, objects, [each.name for each in self.list_fitting(slot)])
        if len(parts) > 1 and self._is_of_both(*parts[:2]):
            self.ask(QuestionKind.HOW_MANY, objects, names)
        alike = self.list_called(self.heads.get(slot, ""), slot) if any(each.only for each in named) else []
        rest = (*(item.name for item in alike), *(name for each in named for name in each.rest))
        spare = tuple(name for each in named for name in each.spare if name not in names)
        return Named(
            names=self.remove(names, objects, slot, spare),
            spare=spare,
            words=self.quote(objects),
            only=any(each.only for each in named),
            by_colour=any(each.by_colour for each in named),
            rest=tuple(name for name in rest if name not in names),
            number=named[0].number,
        )

    def _find_size(self, first: Node) -> str:
        """What chooses of both phrases in `the smaller of the mug and the can`; empty where nothing does."""
        plains = [plain for plain in list_children(first) if has_token(plain, "among")]
        return str(list_children(plains[0])[0].data) if plains else ""

    def _is_of_both(self, first: Node, second: Node) -> bool:
        """Whether a number may count both phrases: `one of the red and blue cubes`."""
        is_counted = any(find_child(first, each) is not None for each in ("any", "number", "exactly", "half"))
        plain = [first, *list_children(first)][-1]
        return is_counted and find_child(plain, "head") is None and len(list_children(second)) == 1

    def remove(self, names: tuple[str, ...], phrase: Node, slot: Slot, spare: Sequence[str] = ()) -> tuple[str, ...]:
        """The names without those of a phrase's exceptions, each of which has to be among them or those to spare.

        Of `two cubes, but not the red one` a spare one takes its place.
        """
        for exception in (child for child in list_children(phrase) if child.data == "except"):
            excepted = self.resolve_except(exception, slot, (*names, *spare))
            number, fresh = len(names) if spare else 0, [name for name in spare if name not in excepted]
            if names and not set(excepted) <= {*names, *spare}:
                self.lack(RequestProblemKind.OBJECT, exception, names)
            names = tuple(name for name in names if name not in excepted)
            self.exempt += excepted if any(phrase.find_data("everything")) else ()
            more = fresh[: max(number - len(names), 0)]
            if len(names) + len(more) < number:
                self.lack(RequestProblemKind.OBJECT, phrase, (*names, *more))
            self.reasons += [f"{self.quote(exception)}: {name} instead" for name in more]
            self.chosen = [name for name in (*self.chosen, *more) if name not in excepted]
            names += tuple(more)
        return names

    def resolve_except(self, exception: Node, slot: Slot, among: tuple[str, ...] = ()) -> tuple[str, ...]:
        """The objects that an exception names, of those that it is an exception from."""
        self.among, before = among, self.among
        found = self._resolve_parts(list_children(exception), slot)
        self.among = before
        return tuple(name for each in found for name in each.names)

    def resolve_one(
        self, noun: Node, slot: Slot, *, lent: str = "", forbids: bool = False, is_pair: bool = False
    ) -> Named:
        """The objects of one phrase; none where it is open or where there is none."""
        find = getattr(self, f"find_{noun.data}", None)  # `it`, `them`, `others`, `everything`, `everything_else`
        if find is None:
            named = self._find_quantified(noun, slot, lent, forbids=forbids, is_pair=is_pair)
        else:
            named = Named(names=find(noun, slot))
        if noun.data == "everything" and slot is Slot.LOOSE:
            named = replace(named, number=self._count_contents(named.names))
        self.recent[-1] += [name for name in named.names if name not in self.recent[-1]]
        self.grouped.update(named.names if len(named.names) > 1 else ())
        if named.only or named.rest or named.by_colour:
            self.unmet = self.quote(noun)
        elif slot is not Slot.LOOSE and noun.data != "everything" and {*named.names} - {*self._list_literal(noun)}:
            said = f"{self.quote(noun)}: {', '.join(named.names)}"
            self.reasons += [] if any(each.startswith(said) for each in self.reasons) else [said]
        return replace(named, words=self.quote(noun))

    def _list_literal(self, noun: Node) -> list[str]:
        """All objects that are called as a phrase says, where no more than nouns and adjectives choose them."""
        literal: list[str] = []
        for plain in noun.find_data("plain"):
            (head, is_plural, _), words = self._read_head(plain), read_adjectives(plain)[0]
            found = [
                each.name
                for each in self.vocabulary.objects.values()
                if head in {each.kind, each.name.split("_")[-1]} and words <= each.words
            ]
            literal += found if is_plural is (len(found) > 1) or is_open(noun) else []
        return literal

    def resolve_aside(self, noun: Node, slot: Slot) -> Named:
        """As `resolve_one`, of a phrase that `it` will not mean."""
        recent = [*self.recent[-1]]
        named = self.resolve_one(noun, slot)
        self.recent[-1] = recent
        return named

    def restrict(self, objects: Named, source: Node, owners: Sequence[str]) -> Named:
        """Of several objects those that stand in or on what `from` names; one object is taken from wherever it is."""
        if len(objects.names) < 2 or not owners:
            return objects
        names = tuple(each.name for each in self._list_standing(map(self.get, objects.names), owners))
        if not names:
            self.lack(RequestProblemKind.OBJECT, f"{objects.words} from {self.quote(source)}", objects.names)
        return replace(objects, names=names)

    def find_it(self, phrase: Node, slot: Slot) -> tuple[str, ...]:
        """The one fitting object of the latest clause with any, else of the last goal; of several, a question."""
        if self.picked and slot is Slot.MOVED:
            return self.picked
        taken = {*self.picked, *self.recent[-1]}
        said = [[name for name in names if name not in taken] for names in reversed(self.recent[:-1])]
        past = self.list_past(is_place=slot is Slot.VESSEL)
        doors = [each.name for each in self.list_fitting(slot)] if slot is Slot.OPENS else []
        for names in (*said, past, doors):
            names = [self.find_opening(name) if slot is Slot.OPENS else name for name in names]
            if found := tuple(dict.fromkeys(name for name in names if slot.takes(self.get(name)))):
                found = tuple(name for name in found if name in self.among) or found
                return found if len(found) == 1 else self.ask(QuestionKind.WHICH, phrase, found)
        if self.questions:
            return ()
        fitting = [each.name for each in self.list_fitting(slot)]
        if not fitting:
            return self.lack(RequestProblemKind.SENTENCE, phrase)
        if len(fitting) == 1 and slot is Slot.VESSEL:
            return tuple(fitting)
        return self.ask(QuestionKind.WHICH, phrase, fitting)

    def find_corrected(self, phrase: Node, slot: Slot) -> tuple[str, ...]:
        """The latter of two phrases; the former, which it corrects, lends its noun."""
        wrong, meant = list_children(phrase)
        if head := self.find_head(wrong):
            self.heads[slot] = head
        return self.resolve_one(meant, slot).names

    def find_rather(self, phrase: Node, slot: Slot) -> tuple[str, ...]:
        """Of `the red cube rather than the blue one` the former.

        What `not the blue one` is about in `the cubes into the red tray, not the blue one` is open.
        """
        is_one = any(has_token(head, "one") for head in list_children(phrase)[1].find_data("head"))
        if (
            slot in {Slot.PLACE, Slot.VESSEL}
            and is_one
            and "not" in str(phrase.children[1])
            and len(self.recent[-1]) > 1
        ):
            return self.lack(RequestProblemKind.SENTENCE, phrase)
        meant, other = self._resolve_parts(list_children(phrase), slot)
        return tuple(name for name in meant.names if name not in other.names)

    def find_alternatives(self, phrase: Node, slot: Slot) -> tuple[str, ...]:
        """The one of `the red or the blue cube` that the person names."""
        names = dict.fromkeys(name for each in self._resolve_parts(list_children(phrase), slot) for name in each.names)
        if has_token(phrase, "any_of") and names:
            return self._choose(Named(names=tuple(names), words=self.quote(phrase)), 1, keeps_rest=False).names
        return self.ask(QuestionKind.WHICH, phrase, names) if len(names) > 1 else tuple(names)

    def find_opening(self, name: str) -> str:
        """What opens of an object: itself, what it is a part of, or its one lid, door or drawer."""
        item = self.get(name)
        parts = [each.name for each in self.vocabulary.objects.values() if each.opens and each.part_of == name]
        found = [name] if item.opens else [item.part_of] if item.part_of else parts
        return found[0] if len(found) == 1 else name

    def find_them(self, noun: Node, _: Slot) -> tuple[str, ...]:
        """The movable objects of the latest clause with several; else all that were moved."""
        groups = [tuple(name for name in before if self.get(name).movable) for before in reversed(self.recent[:-1])]
        found = next((group for group in groups if len(group) > 1), tuple(dict.fromkeys(self.moved)))
        found = found or tuple(name for name in self.list_past() if self.get(name).movable)
        fitting = [each.name for each in self.list_fitting(Slot.MOVED)]
        if not found and len(fitting) > 1:
            is_one_kind = len({self.get(name).kind for name in fitting}) == 1
            return tuple(fitting) if is_one_kind else self.ask(QuestionKind.HOW_MANY, noun, fitting)
        return found if len(found) > 1 else self.lack(RequestProblemKind.SENTENCE, noun)

    def find_everything(self, noun: Node, slot: Slot) -> tuple[str, ...]:
        """All that fits; without a slot, all that can be moved or opened."""
        colours = {str(token) for token in noun.children if get_type(token) == "elliptic"}
        is_unlike = has_token(noun, "untrue")
        fitting = [each for each in self.list_fitting(slot) if slot is not Slot.ANY or each.movable or each.opens]
        found = [item for item in fitting if bool(colours & item.words) is not is_unlike or not colours]
        for tail in list_children(noun):
            found = self._filter(found, tail)
        if slot is Slot.MOVED and not colours:
            self.left_out |= dict.fromkeys(map(" ".join, self.vocabulary.unlisted), "entry for it in the inventory")
        if not found and not self.questions:  # an open one may leave none so far
            self.lack(RequestProblemKind.OBJECT, noun)
        return tuple(item.name for item in found)

    def find_everything_else(self, noun: Node, slot: Slot) -> tuple[str, ...]:
        """All that fits, and of which nothing was said."""
        before = [each for names in self.recent[:-1] for each in names]
        named = [*self.moved, *self.spared, *before] or self.list_past()
        names = tuple(name for name in self.find_everything(noun, slot) if name not in named)
        return names if named else self.lack(RequestProblemKind.SENTENCE, noun)

    def find_every_one_but(self, noun: Node, slot: Slot) -> tuple[str, ...]:
        """Of `all but the yellow one` all of the noun, else all that fits where these are of one kind."""
        if any(map(is_open, list_children(list_children(noun)[0]))):  # `all but two`
            return self.lack(RequestProblemKind.SENTENCE, noun)
        head = self.find_head(noun) or self._find_earlier(slot)
        head = head if len(self._list_alike(head)) > 1 else ""  # `all but the mug` is of more than mugs
        found = self.list_called(head, slot)
        names = tuple(each.name for each in found)
        if (
            not head
            and not self.find_head(noun)
            and len({each.kind for each in found}) < len(found)
            and len({each.kind for each in found}) > 1
        ):
            return self.ask(QuestionKind.HOW_MANY, noun, names)
        return self.remove(names, noun, slot)

    def find_others(self, noun: Node, slot: Slot) -> tuple[str, ...]:
        """Those of which nothing was said, of a noun or of the last one."""
        slot = Slot.MOVED if slot is Slot.ANY else slot
        plain, head = find_child(noun, "plain"), self._find_earlier(slot)
        found = (
            self.list_called(head * (len(self._list_alike(head)) > 1), slot)
            if plain is None
            else self._find_candidates(plain, slot, "")[0]
        )
        single = {name for before in self.recent[:-1] for name in before} - self.grouped
        named = {*self.moved, *self.spared, *single}
        # where there is no more of that noun: `the cubes go there, the rest stays`
        everything = self.list_fitting(slot) if plain is None else []
        left = ([each.name for each in some if each.name not in named] for some in (found, everything) if named)
        names = next((tuple(some) for some in left if some), ())
        return names or self.lack(RequestProblemKind.OBJECT, noun, (each.name for each in found))

    def _resolve_parts(self, parts: Sequence[Node], slot: Slot, **how: bool) -> list[Named]:
        """Each phrase of a list; `the red and the green cube` lends its noun to the first."""
        named = []
        for n, part in enumerate(parts):
            later = (plain for each in parts[n + 1 :] for plain in each.find_data("plain"))
            after = (plain for plain in later if len(plain.children) > 1)  # `the green one and the bottle` lends none
            lent = next(filter(None, (self._read_head(plain)[0] for plain in after)), "")
            named.append(self.resolve_one(part, slot, lent=lent, **how))
        return named

    def _find_quantified(self, noun: Node, slot: Slot, lent: str, *, forbids: bool, is_pair: bool) -> Named:
        *quantities, plain = list_children(noun)
        asked = len(self.questions)
        self.count = next(map(read_number, quantities), 0)
        objects, is_plural, by_colour = self._find_candidates(plain, slot, lent)
        self.count = 0
        found, kind, number, words = tuple(each.name for each in objects), "the", 0, self.quote(noun)
        for quantity in quantities:  # one at most
            kind, number = self._read_quantity(quantity, found, noun, slot)
            kind = "the" if is_pair and kind == "both" else kind
            if has_token(quantity, "other") or has_token(quantity, "another"):
                found = self._drop_named(found, plain, slot)
            if not kind:
                return Named()
        if slot is Slot.LOOSE:
            return self._find_loose(noun, found, kind, number)
        is_one = [str(token) for token in plain.scan_values(lambda _: True)] == ["one"]
        if not quantities and is_one and self.kin and self.heads.get(slot):  # `two cubes go there and one here`
            kind, found = "any", tuple(name for name in self.kin if name not in self.moved)
        found = tuple(name for name in found if name in self.among) or found
        found = self._find_pointed(quantities, found)
        is_pending = asked > 0 and any(has_token(each, "other") for each in quantities)  # than what is not yet chosen
        if not found and len(self.questions) == asked and not is_pending:
            self.lack_named(plain, words)
        named = Named(names=found, words=words, by_colour=by_colour)
        if kind == "their" and slot is Slot.PLACE and len(found) > 1 and not by_colour:
            self.reasons.append(f"{words}: the one of the same colour")
            named = replace(named, by_colour=True)
        if named.by_colour or not found:
            return named
        if is_plural and kind in {"the", "all"} and self._is_vague(plain, found):
            alike = [each.name for each in self.list_called(self._read_head(plain)[0], slot)]
            return Named(names=self.ask(QuestionKind.WHICH, noun, alike, likely=found[0]))
        counts = {"both": 2, "all": number or len(found), "the_number": number, "some": -1}
        if counts.get(kind, len(found)) != len(found):
            self.ask(QuestionKind.HOW_MANY, noun, found)
            return Named()
        if kind in counts or (forbids and kind == "any"):
            return named
        if kind in {"number", "exactly", "any"}:
            return self._choose(named, max(number, 1), keeps_rest=kind == "exactly")
        every = is_plural or (forbids and not quantities)  # `no crumb` is every one
        if kind == "same" or (len(found) > 1 and not every):
            own = [name for name in found if self._read_head(plain)[0] == name.split("_")[-1]]
            is_bare = kind == "the" and len(list_children(plain)) == 1
            if is_bare and len(own) == 1:  # a bench is a table, `table` the one
                return replace(named, names=tuple(own))
            return Named(names=self.ask(QuestionKind.WHICH, noun, found, likely=self._guess(plain, found)))
        return replace(named, only=kind == "only")

    def _find_loose(self, noun: Node, found: Sequence[str], kind: str, number: int) -> Named:
        """Of what is counted in a vessel: at least so many."""
        if kind == "exactly":
            return Named(names=self.lack(RequestProblemKind.CAPABILITY, noun))
        if kind == "some":
            return Named(names=self.ask(QuestionKind.HOW_MANY, noun, ()))
        is_all = kind == "all" and not number
        return Named(names=tuple(found), number=self._count_contents(tuple(found)) if is_all else number)

    def _is_vague(self, plain: Node, found: Sequence[str]) -> bool:
        """Whether a size or a place leaves open which of several are meant: `the little boxes`, `the nearest cubes`."""
        kinds = {str(part.data) for part in list_children(plain)}
        is_ranked, is_chosen = not kinds.isdisjoint(_RANKS), not kinds.isdisjoint({*_RANKS, *_CHOOSING})
        return (is_chosen and len(found) == 1) or (is_ranked and self._read_head(plain)[2])

    def _find_pointed(self, quantities: Sequence[Node], found: tuple[str, ...]) -> tuple[str, ...]:
        """Of several the ones that were named last, where it is `that tray`."""
        is_pointed = any(str(each) in {"this", "that"} for quantity in quantities for each in quantity.children)
        said = [[name for name in names if name in found] for names in reversed(self.recent[:-1])]
        return tuple(next(filter(None, said), found)) if is_pointed else found

    def _read_quantity(self, quantity: Node, found: Sequence[str], noun: Node, slot: Slot) -> tuple[str, int]:
        """The kind and the number of a quantity; no kind where it is open, which is noted."""
        kind, number = str(quantity.data), read_number(quantity)
        said = [str(each) for each in quantity.children if get_type(each) != "number"]
        whole = self._count_contents(found) if slot is Slot.LOOSE else len(found)
        total = find_child(quantity, "total")
        count = read_number(total) if total is not None else len(found)
        if kind == "exactly" and len(said) == 1 and said[0].split()[-1] == "the":  # `only the two cubes` are which
            if number == len(found):
                return "only", 0
            self.lack(RequestProblemKind.SENTENCE, noun)
            return "", 0
        if kind == "any" and number and len(said) == 1 and " of" in said[0]:  # `one of the two`
            kind, count, number = "number", number, 1
        if kind == "all_but":
            kind, number = "number", max(whole - number, 0)
        if kind == "half":
            kind, number = "some" if whole % 2 else "number", whole // 2
        if count != len(found):
            self.ask(QuestionKind.HOW_MANY, noun, found)
            return "", 0
        return kind, number

    def _drop_named(self, found: tuple[str, ...], plain: Node, slot: Slot) -> tuple[str, ...]:
        """Those other than what was moved; of places, than where the object of this clause stands."""
        recent = self.recent[-1]
        is_bare = has_token(find_child(plain, "head") or plain, "one") and len(plain.children) == 1
        if is_bare and self.kin and slot is Slot.PLACE:  # `one cube onto the other`
            return tuple(name for name in self.kin if name not in recent)
        owners = {self.get(each).stands for each in recent} | {*self.list_past(is_place=True)}
        said = {*self.moved, *self.spared, *recent} & {*found}
        before = owners if slot is Slot.PLACE else said or {*self.list_past()}
        left = tuple(name for name in found if name not in before) if before & {*found} else ()
        return tuple(name for name in left if name in self.kin or not is_bare or not self.kin)

    def _choose(self, named: Named, number: int, *, keeps_rest: bool) -> Named:
        """The first of several, where any will do; those that were moved already come last."""
        if number > len(named.names):
            return Named(names=self.lack(RequestProblemKind.OBJECT, named.words, named.names))
        self.kin = named.names
        ordered = sorted(named.names, key=lambda name: name in self.moved)
        names = tuple(name for name in named.names if name in ordered[:number])
        if number < len(named.names):
            self.chosen += names
            self.reasons.append(f"{named.words}: {', '.join(names)}, as any of {', '.join(named.names)} will do")
        return Named(
            names=names,
            rest=named.names if keeps_rest else (),
            spare=tuple(name for name in ordered if name not in names),
        )
