"""From text to its readings: words looked up, then every tree that the grammar of requests has for them.

The grammar (request.lark) is of the language, the words of objects are of the scene. An Earley parser keeps every
reading, so that a sentence with two meanings is found out instead of decided by the order of rules.
"""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence, Set
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache, reduce
from itertools import chain
from math import prod
from pathlib import Path

import yaml
from lark import Lark, Token, Tree
from lark.exceptions import UnexpectedEOF, UnexpectedInput
from lark.grammar import NonTerminal, Rule, Symbol, Terminal
from lark.parsers.xearley import Parser as EarleyParser
from lark.visitors import CollapseAmbiguities

from phyagentos.agent.understanding.asides import drop_asides
from phyagentos.agent.understanding.rewording import reword
from phyagentos.agent.understanding.understanding import Impossible, RequestProblem, RequestProblemKind, refuse
from phyagentos.agent.understanding.vocabulary import Vocabulary, read_lexicon
from phyagentos.errors import find_nearest

MOST_READINGS = 64
MOST_LETTERS = 600
_ALIKE = 0.8  # share of letters, see difflib
LEAST_NEAR = 4  # shorter words of the language are near to anything
_FOLDER = Path(__file__).parent
_WORD = re.compile(r"[a-z][a-z'-]*|\d+(?:\.\d+)?|[^\s\w]")
_GOES_ON = re.compile(
    r"^(?:(?:and|oh|ok|okay|right|great|good|then|could you|can you|please|,) )*"
    r"(?:now|next|also|additionally|in addition|besides)\b"
    r"|^(?:(?:oh|ok|okay|right|great|good|,) )*(?:and|but)\b(?! then\b)(?! not\b)"
    r"|\b(?:too|as well)\s*[,;.!?]*$"
)
_CONDITION = re.compile(r"\b(if|unless|whenever|when|in case)\b[^,;]*")
_PERFECT = re.compile(r"\b(?:after|once|when|as soon as) (?:you have|having) (\w+ed)\b")
_ROOM = re.compile(
    r"^(?:(?:will|can|could|does|do|would)\b.*\bfit|(?:will|can|could)\b.*\bhold\b|"
    r"(?:is|are) there (?:\w+ ){0,2}?(?:room|space)\b|"
    r"how (?:many|much)\b.*\b(?:fit|room|space)\b(?! is between))"
)
_STATED = re.compile(  # a question that begins as a statement does, and is no polite wish
    r"(?:so |and |ok |okay )*((?:the|an?|any\w*|some\w*|my|this|that|these|those|both|all|every\w*|nothing|each)\b"
    r"(?!.*\b(?:please|should|must|could|can|would)\b)[^?]*)\?\W*"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Readings:
    """What was read: a tree for each reading; `unsaid` are words of manner, which no predicate says.

    `is_robots_view` is whether left and right are said to be those of the robot, `goes_on` whether the last goal
    is to hold as well, as in `now ...`, `also ...`.
    """

    text: str
    trees: tuple[Tree[Token], ...]
    unsaid: tuple[str, ...]
    is_robots_view: bool = False
    goes_on: bool = False


def read_request(request: str, vocabulary: Vocabulary) -> Readings | Impossible:
    """Every reading of a request; none where a word is unknown, or from where on it is no sentence."""
    written = " ".join(request.lower().split())
    if first := re.match(r"(?:step )?1[.):] ", written):  # numbered steps
        written = re.sub(r"[,;.]?\s*(?:\band )?(?:\bstep )?(?<!\S)\d[.):] ", " then ", written[first.end() :])
    if len(written) > 4 * MOST_LETTERS:  # courtesies are not counted below
        return refuse(RequestProblemKind.SENTENCE, written[MOST_LETTERS : 2 * MOST_LETTERS])
    text = _spell(written)
    text, count = _GOES_ON.subn("", text.strip())
    text, goes_on = text.strip(" ,"), count > 0
    adjectives, nouns = vocabulary.list_words()
    parser, words = _build_parser(adjectives, nouns, tuple(vocabulary.postures))
    scene = adjectives | nouns | {*map(pluralise, nouns)}
    text, asides = drop_asides(" ".join(text.split()), words, scene)
    text, unsaid, is_robots_view = _drop_phrases(text, words)
    courtesy = _read_phrases()["courtesy"]
    content = sorted({word for word in words if len(word) >= LEAST_NEAR} | adjectives | nouns)
    strange = [word for word in _WORD.findall(text) if word not in words and not re.fullmatch(r"[\d.]+|[+-]", word)]
    condition = _CONDITION.search(text)
    if condition and (strange or condition[1] != "if"):
        return refuse(RequestProblemKind.CONDITION, condition[0].strip(" ,;"))
    if _ROOM.match(text):
        return refuse(RequestProblemKind.ROOM, text.strip(" ;"))
    polite = {each for phrase in courtesy for each in phrase.split() if len(each) > LEAST_NEAR}
    if strange:
        usual = [*content, *(word for word in sorted((words | polite) - {*content}) if len(word) > 1)]
        return _refuse_words(strange, usual, scene)
    if len(text) > MOST_LETTERS:
        return refuse(RequestProblemKind.SENTENCE, text[MOST_LETTERS:])
    try:
        text, forest = _parse(parser, text, reword(text, nouns | {*map(pluralise, nouns)}, adjectives, list_verbs()))
    except UnexpectedInput as error:
        if condition:
            return refuse(RequestProblemKind.CONDITION, condition[0].strip(" ,;"))
        return refuse(RequestProblemKind.SENTENCE, _quote_rest(text, error))
    spoken = scene - {word for phrase in courtesy for word in phrase.split()}
    if lost := _find_lost(written, " ".join((text, *unsaid, *asides)), spoken):
        return refuse(RequestProblemKind.SENTENCE, lost)
    if _count_readings(forest) > MOST_READINGS:
        return refuse(RequestProblemKind.SENTENCE, text)
    trees = CollapseAmbiguities().transform(forest)
    return Readings(
        text=text,
        trees=tuple(dict.fromkeys(trees)),
        unsaid=(*unsaid, *asides),
        is_robots_view=is_robots_view,
        goes_on=goes_on,
    )


def find_beyond(request: str, vocabulary: Vocabulary) -> Impossible | None:
    """Which words of a request, none of this scene, mean what nothing here describes; None where there are none."""
    text, scene = request.lower(), set[str]().union(*vocabulary.list_words())
    found = {
        kind: [words for words in re.findall(rf"(?<![\w-])(?:{known})(?![\w-])", text) if words not in scene]
        for kind, known in read_lexicon()["beyond"].items()
    }
    kind = next((kind for kind, words in found.items() if words), "")
    return refuse(RequestProblemKind[kind.upper()], *dict.fromkeys(found[kind])) if kind else None


def _quote_rest(text: str, error: UnexpectedInput) -> str:
    """From the word on at which a sentence ends to be one."""
    stop = 0 if isinstance(error, UnexpectedEOF) else len(text) - len(text[error.pos_in_stream :])
    return text[text.rfind(" ", 0, stop + 1) + 1 :] or text


def _drop_phrases(text: str, words: Collection[str]) -> tuple[str, tuple[str, ...], bool]:
    """Without phrases of courtesy and manner; those of manner; whether left and right are those of the robot."""
    phrases = _read_phrases()
    unread = [
        phrase for kind in ("manner", "remark") for phrase in phrases[kind] if phrase not in words or " " in phrase
    ]
    unsaid = tuple(re.findall(_alternatives(unread), text))
    text, views = re.subn(_alternatives(phrases["robots_view"]), " ", text)
    idle = (phrase for phrase in phrases["courtesy"] if phrase not in words or " " in phrase)
    text = " ".join(re.sub(_alternatives((*idle, *unread)), " ", text).split())
    text = re.sub(r"[,;](?:\s*[,;])+", lambda found: ";" if ";" in found[0] else ",", text)
    return text.strip(" ,;"), unsaid, views > 0


def _spell(text: str) -> str:
    """What is written as the grammar reads it: turns of phrase, contractions, questions that begin as statements do."""
    if stated := _STATED.fullmatch(text):
        verb = re.fullmatch(r"(.*?)(?: it| they)? (is|are)\b(.*)", stated[1])
        text = f"{verb[2]} {verb[1]}{verb[3]}?" if verb else f"is {stated[1]}?"
    for pattern, spelt in _read_spellings():
        text = pattern.sub(spelt, text)
    return _PERFECT.sub(lambda found: f"after you {_list_participles().get(found[1], found[1])}", text)


Rules = dict[NonTerminal, list[Rule]]


@dataclass(frozen=True, slots=True)
class RequestParser:
    """Reads requests about one scene; the grammar is that of all scenes, the expressions of terminals are its own."""

    earley: EarleyParser
    terminals: Mapping[str, re.Pattern[str]]

    def find_rules(self, text: str) -> Rules:
        """The rules that can be part of a reading: for each of their symbols the text has words."""
        absent = {Terminal(name) for name, pattern in self.terminals.items() if not pattern.search(text)}
        found: set[Symbol] = self.earley.TERMINALS - absent
        left = [r for r in chain.from_iterable(self.earley.predictions.values()) if absent.isdisjoint(r.expansion)]
        while fresh := {rule.origin for rule in left if found.issuperset(rule.expansion)} - found:
            found |= fresh
        return {
            origin: [rule for rule in rules if found.issuperset(rule.expansion)]
            for origin, rules in self.earley.predictions.items()
        }

    def parse(self, text: str, rules: Rules) -> Tree[Token]:
        """Every reading by these rules; raises `UnexpectedInput` from where on there is none."""
        earley = copy(self.earley)  # of this call alone: others may read at the same time
        earley.predictions = rules
        earley.term_matcher = lambda terminal, stream, index=0: self.terminals[terminal.name].match(stream, index)
        found: Tree[Token] = earley.parse(text, "start")  # type: ignore[no-untyped-call]
        return found


def _parse(parser: RequestParser, text: str, others: Iterator[str]) -> tuple[str, Tree[Token]]:
    """The readings of a request; where there are none, those of the first other order of its words that has some."""
    for each in chain((text,), others):
        with suppress(UnexpectedInput):
            return each, parser.parse(each, parser.find_rules(each))
    return text, parser.parse(text, parser.earley.predictions)  # raises where the whole grammar reads no further


def _find_lost(written: str, read: str, scene: Set[str]) -> str:
    """Words of the scene and numbers in what was written that are in nothing that was read; empty where none is."""
    spoken = dict.fromkeys(word for word in _WORD.findall(written) if word in scene or word[0].isdigit())
    kept = {word.removesuffix("s") for word in _WORD.findall(read)}
    return " ".join(word for word in spoken if word.removesuffix("s") not in kept)


def _refuse_words(strange: Iterable[str], usual: Sequence[str], scene: Set[str]) -> Impossible:
    """Each strange word with all of which it may be a slip, and the nearest of these."""
    meant = {word: _list_meant(word, usual, scene) for word in strange}
    kind = RequestProblemKind.WORD
    return Impossible(
        lacks=tuple(
            RequestProblem(kind=kind, words=word, nearest=find_nearest(word, near) or "", possible=near)
            for word, near in meant.items()
        )
    )


def _list_meant(word: str, usual: Iterable[str], scene: Iterable[str]) -> tuple[str, ...]:
    """Known words that a strange one can be a slip of; of the scene's also those that are merely much alike."""
    alike = [each for each in sorted(scene) if each[:1] == word[:1] and min(len(each), len(word)) > LEAST_NEAR]
    slips = (each for each in usual if each != word and is_slip(word, each))
    meant = tuple(dict.fromkeys((*slips, *get_close_matches(word, alike, 2, _ALIKE))))
    return tuple(each for each in meant if find_letters(each) == find_letters(word)) or meant


def find_letters(word: str) -> list[str]:
    """The letters of a word, doubled ones once: alike of `teh` and `the`, which need no question."""
    return sorted(re.sub(r"(.)\1", r"\1", word))


def is_slip(word: str, meant: str) -> bool:
    """Whether a word is another one with a letter wrong, missing, too many, or exchanged with the next; not the first.

    The first letter is hardly ever wrong (Yannakoudakis and Fawthrop 1983, doi:10.1016/0306-4573(83)90045-6).
    """
    is_alike = word[:1] == meant[:1] and abs(len(word) - len(meant)) <= 1  # no pattern is compiled for the others
    cuts = ((meant[:at], meant[at:]) for at in range(1, len(meant) + 1) if is_alike)
    return any(re.fullmatch(f"{a}(.?{b[1:]}|.{b}|{b[1:2]}{b[:1]}{b[2:]})", word) for a, b in cuts)


def _count_readings(tree: Tree[Token]) -> int:
    counts = [_count_readings(child) for child in tree.children if isinstance(child, Tree)]
    return sum(counts) if tree.data == "_ambig" else prod(counts)


def pluralise(noun: str) -> str:
    """The plural of an English noun that has a regular one."""
    if re.search(r"(s|x|z|ch|sh)$", noun):
        return f"{noun}es"
    if re.search(r"[^aeiou]y$", noun):
        return f"{noun[:-1]}ies"
    return f"{noun[:-1]}ves" if noun.endswith("lf") else f"{noun}s"


def _inflect(phrase: str) -> list[str]:
    """A phrase; where a `*` marks its verb also with the third person and the participle."""
    verb, marked, rest = phrase.partition("*")
    return [f"{form}{rest}" for form in (verb, pluralise(verb), f"{_find_stem(verb)}ing")] if marked else [phrase]


def _find_stem(verb: str) -> str:
    """What endings that begin with a vowel are added to."""
    stem = verb[:-1] if re.search("[^e]e$", verb) else verb
    return f"{verb}{verb[-1]}" if re.fullmatch(r"[^aeiou]*[aeiou][^aeiouwxy]", verb) else stem


@lru_cache(maxsize=1)
def list_verbs() -> frozenset[str]:
    """Every verb of requests."""
    phrases = (phrase for each in read_lexicon().values() if isinstance(each, list) for phrase in each)
    return frozenset(phrase.partition("*")[0] for phrase in phrases if "*" in phrase)


@lru_cache(maxsize=1)
def _list_participles() -> dict[str, str]:
    """Perfect participle -> its verb, as far as it is regular."""
    return {f"{_find_stem(verb)}ed": verb for verb in list_verbs()}


@lru_cache(maxsize=1)
def _read_spellings() -> tuple[tuple[re.Pattern[str], str], ...]:
    """Patterns of what is written, and what is read for each."""
    known = yaml.safe_load((_FOLDER / "spellings.yaml").read_text(encoding="utf-8"))
    parts = {f"<{name}>": known[name] for name in ("corrected", "placed")} | {"<verb>": "|".join(sorted(list_verbs()))}
    written = [
        (reduce(lambda text, part: text.replace(*part), parts.items(), pattern), spelt)
        for pattern, spelt in known["spellings"]
    ]
    return tuple((re.compile(pattern), spelt) for pattern, spelt in written)


@lru_cache(maxsize=1)
def _read_phrases() -> dict[str, list[str]]:
    """Terminal -> its phrases, verbs inflected."""
    lists = ((name, phrases) for name, phrases in read_lexicon().items() if isinstance(phrases, list))
    return {name: [form for phrase in phrases for form in _inflect(phrase)] for name, phrases in lists}


def _alternatives(phrases: Iterable[str]) -> str:
    """A regular expression for any of some phrases, the longest first, as whole words."""
    ordered = sorted(set(phrases), key=lambda phrase: (-len(phrase), phrase))
    parts = (re.sub(r"(,|;)\\ ", r"\1\\s*", re.escape(phrase)).replace(r"\ ", r"\s+") for phrase in ordered)
    return rf"(?<![\w-])(?:{'|'.join(parts)})(?![\w-])"


@lru_cache(maxsize=1)
def _read_grammar() -> tuple[EarleyParser, dict[str, re.Pattern[str]]]:
    """The parser for a scene without words, and what it reads as each terminal."""
    terminals = {name: phrases for name, phrases in _read_phrases().items() if name.isupper()}
    terminals |= {name.upper(): ["-"] for name in ("adj", "noun", "elliptic", "posture")}
    grammar = (_FOLDER / "request.lark").read_text(encoding="utf-8")
    lines = [f"{name}: /{_alternatives(phrases)}/" for name, phrases in sorted(terminals.items())]
    lark = Lark(
        "\n".join((grammar, *lines)),
        parser="earley",
        lexer="dynamic",
        ambiguity="explicit",
        maybe_placeholders=False,
    )
    earley = lark.parser.parser  # it predicts all that a rule may begin with, anew for each item: twice the time
    earley.predictions = {
        origin: [rule for rule in rules if rule.origin == origin] for origin, rules in earley.predictions.items()
    }
    return earley, {terminal.name: re.compile(terminal.pattern.to_regexp()) for terminal in lark.terminals}


@lru_cache(maxsize=32)
def _build_parser(
    adjectives: frozenset[str], nouns: frozenset[str], postures: tuple[str, ...]
) -> tuple[RequestParser, frozenset[str]]:
    """The parser for a scene's words, and every word that it knows."""
    scene = {
        "adj": adjectives,
        "noun": {form for noun in nouns for form in (noun, pluralise(noun))},
        "elliptic": adjectives - nouns,
        "posture": {posture.replace("_", " ") for posture in postures} or {"-"},
    }
    earley, of_language = _read_grammar()
    terminals = of_language | {name.upper(): re.compile(_alternatives(words)) for name, words in scene.items()}
    known = {word for each in terminals.values() for word in re.findall(r"[a-z][a-z'-]*", each.pattern)}
    said = (phrases for name, phrases in _read_phrases().items() if name.isupper())
    spoken = {word for phrase in chain(*said, *scene.values()) for word in _WORD.findall(phrase)}
    return RequestParser(earley, terminals), frozenset(
        spoken | {word for word in known if len(word) > 1} | set(",;()&")
    )
