"""From text to its readings: words looked up, then every tree that the grammar of requests has for them.

The grammar (request.lark) is of the language, the words of objects are of the scene. An Earley parser keeps every
reading, so that a sentence with two meanings is found out instead of decided by the order of rules.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from math import prod
from pathlib import Path

from lark import Lark, Token, Tree
from lark.exceptions import UnexpectedEOF, UnexpectedInput
from lark.visitors import CollapseAmbiguities

from phyagentos.agent.understanding.understanding import Impossible, RequestProblem, RequestProblemKind, refuse
from phyagentos.agent.understanding.vocabulary import Vocabulary, read_lexicon
from phyagentos.errors import find_nearest

MOST_READINGS = 64
MOST_LETTERS = 600
LEAST_NEAR = 4  # shorter words of the language are near to anything
_FOLDER = Path(__file__).parent
_WORD = re.compile(r"[a-z][a-z'-]*|\d+(?:\.\d+)?|[^\s\w]")
_CONDITION = re.compile(r"\b(if|unless|whenever|when|in case)\b[^,;]*")
_PLACED = r" (?:in|into|on|onto|to)\b|\s*(?:[,;.]|$)"
_CORRECTED = (
    r"\b(?:oh|wait|hold on|hang on|oops|sorry|no|i mean|i meant|actually|or rather|scratch that|make that|my mistake)\b"
)
_SHORT = (  # contractions and spellings
    (r"[’`]", "'"),
    (r"\b(do|does|did|must|should|would|could|wo|ca|is|are|need)n't\b", r"\1 not"),
    (r"\b(do|does|did|should|is|are|wo|ca)nt\b", r"\1 not"),
    (r"\bwo not\b", "will not"),
    (r"\bca not\b|\bcannot\b", "can not"),
    (r"\bi'd\b", "i would"),
    (r"\b(it|that|there|where|what|who|how)'s\b|\b(that|there|where|what)s\b", r"\1\2 is"),
    (r"\b(you|they|we)'re\b", r"\1 are"),
    (r"\b(?:unless (it|that|they) (is|are)|if (it|that|they) (is|are) not) already\b", "being already"),
    (r",? being already(?: (?:there|in there|in it|on it|inside|done|so))?\s*(?=$|[.;!])", ""),
    (r"\bwhichever ((?:\w+ )?\w+) (is|are)\b", r"the \1 that \2"),
    (r"\bcolor", "colour"),
    (r"\b(?!same\b|correspondingly\b)(\w+)[- ]coloured\b", r"\1"),
    (r"(\d)(cm|mm|m|°)\b", r"\1 \2"),
    (r"(?:,| and|, and) ([^,;.!?]+?) (?:afterwards|after that)\s*(?=$|[.;!])", r" then \1"),
    (r"\bgray\b", "grey"),
    (r"\bcenter", "centre"),
    (
        r"\b(nearest|closest|nearer|closer|towards?|farthest|furthest|away)( to| from)? (?:the robot|yourself)\b",
        r"\1\2 you",
    ),
    (r"\b(nearest|closest|farthest|furthest) (\w+(?: \w+)?) (?:to|from) (?:the robot|you|yourself)\b", r"\1 \2"),
    (r"\b(close|shut)((?: \w+){1,4}?),? if (?:it|they) (?:is|are) (?:still open|open|not closed|not shut)\b", r"\1\2"),
    (r"\b(open)((?: \w+){1,4}?),? if (?:it|they) (?:is|are) (?:still |)(?:closed|shut|not open)\b", r"\1\2"),
    (r"\s[-\u2013\u2014]+\s|\u2014", " , "),
    (rf"(?<=\w)\s*[,;]?\s*(?:{_CORRECTED})(?:\s*,?\s*(?:{_CORRECTED}))+\b(?! not\b)\s*,?\s*", " , no , "),
    (r"\b(except|except for|but|apart from) what is\b", r"\1 everything that is"),
    (r"(^|[,;] |\b(?:and|but|then) )just (?!the\b|an?\b|one\b)", r"\1"),
    (r"(^|[,;] )only (\w+) the\b", r"\1\2 only the"),
    (r"\bcan you see\b", "do you see"),
    (r"\bwhat (?:all )?can you do(?: here| for me)?\b", "what can be done"),
    (r"\bwhatever (?:is|lies|stands)\b", "everything that is"),
    (rf"\bthe other(?={_PLACED})", "the other one"),
    (rf"\bthe other (two|three|four|five|six)(?={_PLACED})", r"the other \1 ones"),
    (r"^((?:is|are|has|have|does|do) .*?) (?:yet|still)\b", r"\1"),
    (r"\b(if [^,]*?\b(?:is|are)) (?:still|already)\b", r"\1"),
    (r"\bnot yet\b", "not"),
    (rf"^(?:{_CORRECTED})(?:\s*,?\s*(?:{_CORRECTED}))+\s*,?\s*", "no , "),
    (r"\bsomething (?!in\b|on\b|else\b|to\b|into\b|that\b)(\w+)", r"a \1 thing"),
    (r"\b(stand|be) (upright|open|closed|shut|empty) again\b", r"\1 \2"),
    (r"\btogether (?=in\b|into\b|on\b|onto\b)", ""),
    (r"\bback out\b", "out"),
    (r"(\bnot\b[^,;]*?) yet\b", r"\1"),
    (r"^(?:(?:no|sorry|oops)\s*[,;.]?\s*)?wrong (\w+)\s*[,;.:]\s*(?:i meant? )?(the \w+) one\b", r"no , \2 \1"),
    (
        r"\bexcept (the (?:\w+ )?\w+),? (?:which|that) (goes|should go|must go|has to go|belongs)\b",
        r"except \1 , \1 \2",
    ),
    (r"\bput (.+?) where (.+?) (?:is|was),? and \2 where \1 (?:is|was)\b", r"swap \1 and \2"),
    (r"\binstead of\b", "rather than"),
    (
        r"^((?:please |could you |can you )*)(?:sort|tidy|arrange|organi[sz]e)(?: up| out)?"
        r"(?: them| these| those| everything)?(?: as follows| like this| this way)?\s*:\s*",
        r"\1put ",
    ),
    (
        r"\bclear (everything|all|every|both)\b(?![^,;]*\b(?:off|from|out)\b)(?=[^,;]* (?:onto|into|on|in|to) )",
        r"put \1",
    ),
    (r"_", " "),
    (r"(?<!\d)[.!:?]+|[.!:?]+(?!\d)", " ; "),
    (r"([,;()&])", r" \1 "),
    (r"\s*,(\s*,)+", " ,"),
    (r",?\s*\b(after that|then|afterwards|finally|next)\s*,", r" \1 "),
    (r",\s*(except|except for|apart from|but not) ([^,;]+),", r" \1 \2 "),
    (r"\bnothing else (is |gets |should be |may be )?(moved|moves|touched)\b", "do not move anything else"),
    (r",? and nothing else\s*(?=$|[.;!])", " and do not move anything else"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Readings:
    """What was read: a tree for each reading; `unsaid` are words of manner, which no predicate says.

    `is_robots_view` is whether left and right are said to be those of the robot.
    """

    text: str
    trees: tuple[Tree[Token], ...]
    unsaid: tuple[str, ...]
    is_robots_view: bool = False


def read_request(request: str, vocabulary: Vocabulary) -> Readings | Impossible:
    """Every reading of a request; none where a word is unknown, or from where on it is no sentence."""
    text = " ".join(request.lower().split())
    if len(text) > 4 * MOST_LETTERS:  # courtesies are not counted below
        return refuse(RequestProblemKind.SENTENCE, text[MOST_LETTERS : 2 * MOST_LETTERS])
    for pattern, spelt in _SHORT:
        text = re.sub(pattern, spelt, text)
    adjectives, nouns = vocabulary.list_words()
    parser, words = _build_parser(adjectives, nouns, tuple(vocabulary.postures))
    courtesy, manner = (_read_phrases()[name] for name in ("courtesy", "manner"))
    unsaid = tuple(re.findall(_alternatives(manner), text))
    text, views = re.subn(_alternatives(_read_phrases()["robots_view"]), " ", text)
    idle = (phrase for phrase in courtesy if phrase not in words or " " in phrase)
    text = re.sub(_alternatives((*idle, *manner)), " ", text)
    text = re.sub(r",(?:\s*,)+", ",", " ".join(text.split())).strip(" ,;")
    content = sorted({word for word in words if len(word) >= LEAST_NEAR} | adjectives | nouns)
    strange = [word for word in _WORD.findall(text) if word not in words and not re.fullmatch(r"[\d.]+|[+-]", word)]
    condition = _CONDITION.search(text)
    if condition and (strange or condition[1] != "if"):
        return refuse(RequestProblemKind.CONDITION, condition[0].strip(" ,;"))
    if near := {word: _find_meant(word, content) for word in strange}:
        usual = [*content, *(word for word in sorted(words - {*content}) if len(word) > 1)]
        return Impossible(
            lacks=tuple(
                RequestProblem(
                    kind=RequestProblemKind.WORD,
                    words=word,
                    nearest=near[word],
                    possible=tuple(each for each in usual if is_slip(word, each)),
                )
                for word in near
            )
        )
    if len(text) > MOST_LETTERS:
        return refuse(RequestProblemKind.SENTENCE, text[MOST_LETTERS:])
    try:
        forest = parser.parse(text)
    except UnexpectedInput as error:
        if condition:
            return refuse(RequestProblemKind.CONDITION, condition[0].strip(" ,;"))
        stop = 0 if isinstance(error, UnexpectedEOF) else error.pos_in_stream
        return refuse(RequestProblemKind.SENTENCE, text[stop:] or text)
    if _count_readings(forest) > MOST_READINGS:
        return refuse(RequestProblemKind.SENTENCE, text)
    trees = CollapseAmbiguities().transform(forest)
    return Readings(text=text, trees=tuple(dict.fromkeys(trees)), unsaid=unsaid, is_robots_view=views > 0)


def _find_meant(word: str, known: Iterable[str]) -> str:
    """The known word that a strange one looks like: it begins alike, and few letters differ; or empty."""
    near = find_nearest(word, [each for each in known if each[:2] == word[:2] or is_slip(word, each)])
    return near or ""


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
    if not marked:
        return [phrase]
    stem = verb[:-1] if re.search("[^e]e$", verb) else verb
    stem = f"{verb}{verb[-1]}" if re.fullmatch(r"[^aeiou]*[aeiou][^aeiouwxy]", verb) else stem
    return [f"{form}{rest}" for form in (verb, pluralise(verb), f"{stem}ing")]


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


@lru_cache(maxsize=32)
def _build_parser(
    adjectives: frozenset[str], nouns: frozenset[str], postures: tuple[str, ...]
) -> tuple[Lark, frozenset[str]]:
    """The parser for a scene's words, and every word that it knows."""
    scene = {
        "adj": adjectives,
        "noun": {form for noun in nouns for form in (noun, pluralise(noun))},
        "elliptic": adjectives - nouns,
        "posture": {posture.replace("_", " ") for posture in postures} or {"-"},
    }
    terminals = {name: phrases for name, phrases in _read_phrases().items() if name.isupper()}
    terminals |= {name.upper(): sorted(words) for name, words in scene.items()}
    grammar = (_FOLDER / "request.lark").read_text(encoding="utf-8")
    lines = [f"{name}: /{_alternatives(phrases)}/" for name, phrases in sorted(terminals.items())]
    parser = Lark(
        "\n".join((grammar, *lines)),
        parser="earley",
        lexer="dynamic",
        ambiguity="explicit",
        maybe_placeholders=False,
    )
    earley = parser.parser.parser  # it predicts all that a rule may begin with, anew for each item: twice the time
    earley.predictions = {
        origin: [rule for rule in rules if rule.origin == origin] for origin, rules in earley.predictions.items()
    }
    known = {word for terminal in parser.terminals for word in re.findall(r"[a-z][a-z'-]*", terminal.pattern.value)}
    phrases = (phrase for each in terminals.values() for phrase in each)
    spoken = {word for phrase in phrases for word in _WORD.findall(phrase)}
    return parser, frozenset(spoken | {word for word in known if len(word) > 1} | set(",;()&"))
