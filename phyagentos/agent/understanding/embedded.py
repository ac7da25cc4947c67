"""The embedded understander: a grammar over the words of the scene. Knows no model and no network."""

import re
from collections.abc import Mapping
from dataclasses import replace
from itertools import islice, product

from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.understanding.clauses import Clauses
from phyagentos.agent.understanding.grounding import iter_named
from phyagentos.agent.understanding.inquiries import read_inquiry
from phyagentos.agent.understanding.phrases import Node, get_type, has_token, list_children, list_tokens
from phyagentos.agent.understanding.reading import Readings, find_beyond, find_letters, list_verbs, read_request
from phyagentos.agent.understanding.steps import finish, get_object, list_flipped, says_place
from phyagentos.agent.understanding.understanding import (
    OF_WORDS,
    Ambiguous,
    Impossible,
    Inquiry,
    Question,
    QuestionKind,
    RequestProblemKind,
    Understanding,
    Understood,
    conclude,
    refuse,
)
from phyagentos.agent.understanding.vocabulary import Vocabulary
from phyagentos.protocol.predicates.predicate import find_entities

Texts = tuple[str, ...]
_SPELLINGS_MAX = 24  # of a request with several slips
_TAKEN_BACK = {"correction", "instead", "rather_than", "untrue"}  # what stands beside it is not meant
_SAYS_MORE = re.compile(
    r"\b(?:an?|any|apart|aside|away|but|by|each|every|except|first|if|in|inside|into|last|left|next|no|not|on|one|onto|"
    r"only|right|some|then|three|to|two|unless|until|with|without)\b"
)
READING = "reading"  # key of the question which of several readings is meant


class EmbeddedUnderstander:
    """Reads a request by the grammar; what it does not know is asked or refused, never skipped."""

    def understand(self, request: str, vocabulary: Vocabulary, answers: Mapping[str, str]) -> Understanding:
        """The goal of a request, or why there is none; `answers` maps keys of questions to the chosen candidates."""
        found = self._understand(request, vocabulary, answers)
        head, mark, body = request.partition(":")
        if isinstance(found, Ambiguous | Impossible) and mark and head.strip() and body.strip():
            listed = self._join(head, body, vocabulary, answers)
            found = listed if isinstance(listed, Understood) or (listed and isinstance(found, Impossible)) else found
        return find_beyond(request, vocabulary) or found if _is_of_words(found) else found

    def _join(self, head: str, body: str, vocabulary: Vocabulary, answers: Mapping[str, str]) -> Understanding | None:
        """What is listed in `pile the cubes: yellow on green, red on yellow`, and what its heading wishes for besides.

        None where the heading is neither a goal nor a mere verb with its objects, each of which is listed.
        """
        listed, headed = (self.understand(each, vocabulary, answers) for each in (body, head))
        if isinstance(headed, Inquiry) or not (isinstance(headed, Understood) or _is_mere(head)):
            return None
        if not isinstance(listed, Understood):
            return listed if isinstance(listed, Ambiguous) else None
        goal = listed.goal
        about = {name for step in (*goal.steps, goal.accept) for text in step for name in find_entities(text)}
        if not isinstance(headed, Understood) and any(
            names.isdisjoint(about) for _, names in iter_named(head, vocabulary)
        ):
            return None
        if isinstance(headed, Understood) and (headed.goal.steps or headed.goal.constraints):
            return None
        placed, wished = set(map(get_object, goal.accept)), headed.goal.accept if isinstance(headed, Understood) else ()
        accept = (*goal.accept, *(each for each in wished if not (says_place(each) and get_object(each) in placed)))
        reasons = (*listed.reasons, f"{head.strip()}: as is listed")
        return replace(listed, goal=goal.model_copy(update={"accept": accept}), reasons=reasons)

    def _understand(self, request: str, vocabulary: Vocabulary, answers: Mapping[str, str]) -> Understanding:
        read = read_request(request, vocabulary)
        if isinstance(read, Impossible):
            return self._respell(read, request, vocabulary, answers)
        trees = [tree for tree in read.trees if not any(tree.find_data("unplaced"))]  # the last resort
        results = [_interpret(tree, read, request, vocabulary, answers) for tree in trees or read.trees]
        understood = [result for result in results if isinstance(result, Understood)]
        goals = {
            _summarise(each.goal): each for each in understood if not any(_is_laxer(each, one) for one in understood)
        }
        if len(goals) > 1 and (answer := answers.get(READING)) not in goals:
            question = Question(kind=QuestionKind.READING, key=READING, words=request, candidates=tuple(goals))
            return Ambiguous(questions=(question,))
        if goals:
            return next(iter(goals.values())) if len(goals) == 1 else goals[str(answer)]
        if inquiries := [result for result in results if isinstance(result, Inquiry)]:
            return inquiries[0]
        if asked := [result for result in results if isinstance(result, Ambiguous)]:
            return min(asked, key=lambda result: len(result.questions))
        refused = (result for result in results if isinstance(result, Impossible))
        return min(refused, key=lambda result: len(result.lacks))

    def _respell(
        self, refused: Impossible, request: str, vocabulary: Vocabulary, answers: Mapping[str, str]
    ) -> Understanding:
        """Ask whether known words were meant that make a request of it; the refusal where none do."""
        if any(lack.kind is not RequestProblemKind.WORD for lack in refused.lacks):
            return refused
        words = [lack.words for lack in refused.lacks]
        spelt: dict[str, tuple[str, ...]] = {}
        for near in islice(product(*(lack.possible for lack in refused.lacks)), _SPELLINGS_MAX):
            spelt[_replace_words(request, dict(zip(words, near, strict=True)))] = near
        read = {text: self.understand(text, vocabulary, answers) for text in spelt if text != request}
        found = {text: each for text, each in read.items() if not isinstance(each, Impossible)}
        if not found and len(words) == 1 and (without := self._read_without(words[0], request, vocabulary, answers)):
            return without
        if not found:  # the spelling is right where what it makes of the request cannot be met here
            return next((each for each in read.values() if not _is_of_words(each)), refused)
        key, meant = ", ".join(words), dict[object, tuple[str, Understanding]]()
        for text, each in found.items():
            meant.setdefault(_outline(each), (spelt[text][0] if len(words) == 1 else text, each))
        named = dict(meant.values())
        ((_, read_so), *more), near = meant.values(), spelt[next(iter(found))]
        if (
            not more
            and isinstance(read_so, Understood)
            and list(map(find_letters, words)) == list(map(find_letters, near))
        ):
            return replace(read_so, reasons=(*read_so.reasons, f"{', '.join(words)}: {', '.join(near)}"))
        if (answer := answers.get(key)) in named:
            return named[str(answer)]
        question = Question(
            kind=QuestionKind.SPELLING, key=key, words=key, candidates=tuple(named), likely=next(iter(named))
        )
        return Ambiguous(questions=(question,))

    def _read_without(
        self, word: str, request: str, vocabulary: Vocabulary, answers: Mapping[str, str]
    ) -> Ambiguous | Understood | None:
        """`the coke can`, `the metal tin`: a question which can that is, or whether this is meant."""
        shorter = re.sub(rf"(?i)\b((?:the|an?|my|this|that)(?: \w+)?) {re.escape(word)} (?=\w)", r"\1 ", request)
        found = self.understand(shorter, vocabulary, answers) if shorter != request else None
        if isinstance(found, Understood):
            meant = _summarise(found.goal)
            question = Question(kind=QuestionKind.READING, key=word, words=word, candidates=(meant,))
            return found if answers.get(word) == meant else Ambiguous(questions=(question,))
        is_open = isinstance(found, Ambiguous) and {each.kind for each in found.questions} == {QuestionKind.WHICH}
        return found if isinstance(found, Ambiguous) and is_open else None


def _is_of_words(found: Understanding) -> bool:
    """Whether it is a refusal of words or of the sentence alone."""
    return isinstance(found, Impossible) and {lack.kind for lack in found.lacks} <= OF_WORDS


def _interpret(
    tree: Node, read: Readings, request: str, vocabulary: Vocabulary, answers: Mapping[str, str]
) -> Understanding:
    said = Clauses(text=read.text, vocabulary=vocabulary, answers=answers, view=1.0 if read.is_robots_view else 0.0)
    said.recall()
    if has_token(tree, "then") and not vocabulary.past:
        said.lack(RequestProblemKind.PAST, read.text)
    root = list_children(tree)[0]
    if root.data.startswith("ask_"):
        said.asks = True
        inquiry = read_inquiry(said, root)
        return said.conclude() or inquiry
    plan = said.read_plan(root)
    undone = (
        {each for step in plan for text in step for each in list_flipped(text)}
        if any(root.find_data("once_more"))
        else set[str]()
    )
    # `and then close it` goes on from the last goal, and so do `now close it` and `close it again`
    is_next = has_token(tree, "then") or any(not undone.isdisjoint(past.accept) for past in vocabulary.past[-1:])
    latest = vocabulary.past[-1:] if is_next or (read.goes_on and not said.again) else ()
    earlier = [step for past in latest for step in (*past.steps, past.accept)]
    steps, accept = finish([*earlier, *plan])
    flipped = {each for text in accept for each in list_flipped(text)}
    if not is_next and latest and flipped.isdisjoint(earlier[-1]):
        steps = tuple(step for step in steps if step != tuple(earlier[-1]))
    constraints = (*(text for past in latest for text in past.constraints), *said.constraints)
    said.reasons += [f"after: {past.objective}" for past in latest]
    if said.again and not vocabulary.past:
        said.lack(RequestProblemKind.PAST, read.text)
    elif said.again:
        past, excepted = vocabulary.past[-1], set(said.excepted)
        before = (past.constraints, *past.steps, past.accept)
        kept = [tuple(text for text in texts if not excepted & set(find_entities(text))) for texts in before]
        said.reasons.append(f"as before: {past.objective}")
        constraints = tuple(dict.fromkeys((*kept[0], *constraints)))
        steps = (*(step for step in kept[1:-1] if step), *steps)
        accept = tuple(dict.fromkeys((*kept[-1], *accept)))
    accept, constraints = _begin(said, steps, accept, constraints)
    if not accept and not said.lacks and not said.questions:
        said.lack(RequestProblemKind.GOAL, read.text)
    if open_or_missing := said.conclude():
        return open_or_missing
    about = {name for step in (*steps, accept, constraints) for text in step for name in find_entities(text)}
    if unheard := _list_unheard(tree, vocabulary, about | said.heard):
        return refuse(RequestProblemKind.SENTENCE, *unheard)
    parts = {"constraints": constraints, "steps": steps, "accept": accept}
    reasons, chosen = (tuple(dict.fromkeys(each)) for each in (said.reasons, said.chosen))
    told = {"reasons": reasons, "left_out": said.left_out, "unsaid": (*read.unsaid, *said.unsaid), "chosen": chosen}
    return conclude(request, vocabulary, parts, **told)


def _is_mere(head: str) -> bool:
    """Whether a heading is a verb with its objects: it says neither where to, nor how many or which of them."""
    said = re.sub(r"\b(please|in there|out there|up here)\b", " ", head.lower()).strip()
    return said.split(" ")[0] in list_verbs() and not _SAYS_MORE.search(said)


def _list_unheard(tree: Node, vocabulary: Vocabulary, heard: set[str]) -> list[str]:
    """Names in a request of which no object was heard, where nothing is corrected or negated."""
    tokens = list_tokens(tree)
    spoken = " ".join(each if get_type(each) in {"noun", "adj", "elliptic"} else "," for each in tokens)
    unheard = [words for words, names in iter_named(spoken, vocabulary) if names.isdisjoint(heard)]
    return unheard if _TAKEN_BACK.isdisjoint(map(get_type, tokens)) else []


def _is_laxer(one: Understood, other: Understood) -> bool:
    """Whether a goal is another one without some of its constraints."""
    bare, full = one.goal, other.goal
    return (bare.steps, bare.accept) == (full.steps, full.accept) and {*bare.constraints} < {*full.constraints}


def _begin(said: Clauses, steps: tuple[Texts, ...], accept: Texts, constraints: Texts) -> tuple[Texts, Texts]:
    """What must hold all through, but does not as the scene begins, is wanted in the end.

    So it is of what the goal brings about, and of a state of an object that it is about; any other is a lack.
    """
    about = {name for text in (*accept, *(text for step in steps for text in step)) for name in find_entities(text)}
    late = tuple(text for text in constraints if said.vocabulary.is_known(text, is_true=False))
    for text in late:
        if text not in accept and (len(find_entities(text)) > 1 or not about.issuperset(find_entities(text))):
            said.lack(RequestProblemKind.START, text)
    said.reasons += [f"{text} does not hold at first, so it is wanted in the end" for text in late]
    return tuple(dict.fromkeys((*accept, *late))), tuple(text for text in constraints if text not in late)


def _replace_words(text: str, words: Mapping[str, str]) -> str:
    return re.sub(r"[\w'-]+", lambda found: words.get(found[0].lower(), found[0]), text)


def _outline(found: Understanding) -> object:
    """What is alike of readings that differ in spelling alone."""
    match found:
        case Understood(goal=goal):
            return _summarise(goal)
        case Ambiguous(questions=questions):
            return tuple((each.kind, each.candidates) for each in questions)
        case Inquiry(statements=statements):
            return tuple(statements.items())
    return found


def _summarise(goal: WantedGoal) -> str:
    """A goal in one line, to be chosen from."""
    always = f"; always {', '.join(goal.constraints)}" if goal.constraints else ""
    return ", then ".join(map(", ".join, (*goal.steps, goal.accept))) + always
