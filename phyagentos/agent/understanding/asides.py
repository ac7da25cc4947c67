"""Asides of a request: courtesies before a verb, reasons, purposes, remarks and adverbs of manner.

Upstream: the spelling of a request. Downstream: the grammar, which knows none of them. An aside is left out only where
nothing of it could be part of a goal: no word of the scene, number, negation, condition or time. What is left out, save
courtesies, is returned, since a person has to see it.
"""

import re
from collections.abc import Callable, Set
from functools import partial

from phyagentos.agent.understanding.vocabulary import read_lexicon

_LEAD = (
    "a|ah|am|any|appreciate|awesome|be|big|bit|bother|chance|could|do|does|dear|er|erm|excuse|favou?r|for|glad|good|"
    "grateful|great|guess|happy|hello|help|helpful|hey|hi|hmm?|hope|hoping|i|if|is|it|just|kind|kindly|like|little|"
    "lovely|love|maybe|me|might|much|my|nice|of|oh|ok|okay|perhaps|please|possible|possibly|really|robot|so|sorry|sort|"
    "suppose|that|there|think|thinking|thought|to|trouble|um+|uh+|us|very|was|way|well|were|whether|wonder|wonderful|"
    "wondering|would|you|obliged|delighted|pleased|today|have|might"
)
_MODAL = "could|can|would|will|might"  # `should you drop it` is a condition
_SOFT = (
    rf"{_MODAL}|to|please|kindly|maybe|perhaps|possibly|just|quickly|now|also|to|go ahead and|go and|be able to|"
    "manage to|at least|try to|try and|be so kind as to|be a dear and|help me|help me to|help us|mind|"
    "be willing to|be so good as to"
)
_COURTESY = re.compile(
    rf"(^|[,;] )(?:(?:{_LEAD}|,) )*?"
    rf"(?:(?:{_MODAL}) you|(?:may|might|can|could) i (?:ask|trouble|bother|beg|request)(?: of)? (?:you )?to|"
    r"(?:want|need|like|love|have|get|ask|asking|wish|for|expect|trust) you to|"
    rf"(?:if|whether|that|chance|hoping|hope|think|thinking|wondering|wish|maybe|"
    rf"perhaps|possibly|guess|suppose) you (?:{_MODAL}))"
    rf"(?: (?:{_SOFT}))* (not )?(?!see\b|have\b)"
)
_WISH = re.compile(
    rf"(?:^|(?<=[,;] ))(?:(?:{_LEAD}) )*?(?:(?:it|that|i) would (?:be|look|seem|feel) (?:\w+ )?\w+|"
    r"i (?:would|should) (?:be (?:\w+ )?\w+|(?:really |so )?(?:love|like|prefer|appreciate)(?: it)?)) if "
    r"(?!you\b)([^,;]+?) (?:(could|would|might) (?!be\b)|"
    r"(?:was|were|stood|sat|ended up|would be|could be|went|got|is|are)\b)"
)
_SOUND = re.compile(
    r"^(?:(?:ugh|wow|phew|argh|oh|ah|u[mh]+|er+m?|hm+|yes|"
    r"yeah|yep|sure|great|perfect|nice|good|cool)(?: ,)? (?!no\b|not\b))+"
)
_REASONS = (
    r"\b(?:because|cause|cos|cuz|seeing (?:that|as)|given that)\b[^,;]*",
    r"\b(?:since|as) (?:i|we|my|our|he|she|guests|people|someone|somebody|"
    r"(?:it|there|that) (?:is|was|has)|the \w+ (?:is|are|was|has|have)) [^,;]*",
    r"\bso(?: that)? (?:(?:i|we|he|she|my \w+|our \w+|people|everyone|everybody|guests) "
    r"(?:can|could|do|will|may|might|have|get|am|are|need)|nobody|no one) [^,;]*",
    r"\b(?:in order to|to (?:make|free up|have|get) (?:some )?(?:more )?(?:room|space))\b[^,;]*",
)
_MANNER = (
    r"\b(?:by|using|with|at) (?:its|the|their) (?:\w+ )?(?:handle|knob|grip)s?\b(?=\s*(?:[,;]|$))(?<!\bopen the handle)"
    r"|\b(?:side by side|next to each other|in a (?:neat )?row) (?=in\b|into\b|on\b|onto\b)"
)
_NEXT_PART = re.compile(r"\b(?:and|but|then|or)\b(?! (?:i|we|my|our|he|she|they|it is|there)\b)")
_FOR = re.compile(
    r"(?<!look )(?<!search )(?<!same )\bfor (?:(?!and\b|with\b|in\b|into\b|on\b|onto\b|to\b)[a-z'-]+ ?){1,5}"
    r"(?=\s*(?:[,;]|$)|and\b)"
)
_TRADED = re.compile(r"\b(?:look|search|swap|exchang|replac|substitut|trad|wait|hold|keep|stay)")
_REMARK = re.compile(
    r"(?:and |but |well |so )?"
    r"(?:(?:yesterday|today|earlier|tomorrow|recently|usually|sometimes|honestly|anyway|anyhow),? )*"
    r"(?:i|we|he|she|there (?:is|are|was|were|has)|"
    r"(?:it|they|that|this|(?:the|those|these|my|our|his|her)(?: \w+){1,2}|some\w+|every\w+|people|"
    r"\w+s|dinner|lunch|breakfast|today|tonight) "
    r"(?:is|are|was|were|has|have|had|will be|keeps?|came|went|got|made|wants?|likes?|\w+ed))\b"
)
_PERSON = r"(?:(?:i|we|he|she|they|some(?:one|body)|people|my \w+)(?: just| always| really| still| do| already)*)"
_STATEMENT = re.compile(
    rf"(?:(?:and|but|well|oh|look|see) )*(?:{_PERSON} (?:think|believe|see|guess) )?(?:"
    rf"{_PERSON} (?:left|leave|keep|kept|dropped|knocked|tipped|spilled|forgot|put|made|got|has|have|had|see|saw)|"
    r"(?:there|it|that|this|(?:the|my|our|that|this|those|these|an?|some)(?: [\w-]+){1,6}?)(?: there| here)? "
    r"(?:is|are|was|were|has|had|have|looks?|seems?|keeps?|fell|rolled|slid|got))\b"
)
_WISHED = re.compile(
    r"\b(?:should|must|ought|needs?|wants?|may|shall|let|except|unless|until|if|when|never|no|not|please|to be|"
    r"(?:is|are|has|have) to|supposed|meant|allowed|forbidden|banned|limits|reserved)\b"
)
_FIRST_PERSON = re.compile(
    r"(?:i|we) (?:can|could|am|are) (?:not|looking)|(?:i|we) (?:need|want|have|would like|am going|am about) to\b"
)


def drop_asides(text: str, known: Set[str], scene: Set[str]) -> tuple[str, tuple[str, ...]]:
    """A request without its asides, and those that are no mere courtesies; `scene` are the words of objects here."""
    dropped: list[str] = []
    text = _drop_courtesies(text)

    def drop(found: re.Match[str], is_idle: Callable[[str], bool]) -> str:
        if not is_idle(found[0]):
            return found[0]
        dropped.append(found[0].strip(" ,;"))
        return " "

    for pattern in _REASONS:
        text = re.sub(pattern, partial(drop, is_idle=lambda said: not _NEXT_PART.search(said)), text)
    text = re.sub(
        r"\bso (?:that )?[a-z]+ (?:is|are|can|will|gets?|stays?)\b[^,;]*",
        partial(drop, is_idle=lambda said: _is_idle(said.removeprefix("so ").removeprefix("that "), known, scene)),
        text,
    )
    text = re.sub(
        r"\bbefore (?:[a-z'-]+ ?){1,4}(?=\s*(?:[,;]|$))",
        partial(drop, is_idle=lambda said: _is_idle(said.removeprefix("before "), known, scene)),
        text,
    )
    text = re.sub(_MANNER, partial(drop, is_idle=bool), text)
    text = re.sub(
        r"\b(in|on|onto|into) the (?:very |exact )?(?:centre|middle) of (?=the\b|my\b|your\b)",
        lambda found: f"{drop(found, bool)}{found[1]} ",
        text,
    )
    if not _TRADED.search(text):
        text = _FOR.sub(partial(drop, is_idle=lambda said: _is_idle(said.removeprefix("for "), known, scene)), text)
    text = re.sub(
        r"(?<!the )(?<!a )(?<!an )(?<!my )\b[a-z]+ly\b",
        partial(drop, is_idle=lambda said: said not in known and said not in read_lexicon()["not_of_manner"]["words"]),
        text,
    )
    text, remarks = _drop_remarks(text, known, scene)
    return re.sub(r"^[\s,;]+", "", text).strip(), (*dropped, *remarks)


def _drop_remarks(rest: str, known: Set[str], scene: Set[str]) -> tuple[str, list[str]]:
    """The parts of a request that are no remarks, with what a remark names for a later `it`, and the remarks."""
    dropped: list[str] = []
    text = ""
    while rest:
        said, mark, rest = re.fullmatch(r"([^,;]*)([,;]?)\s*(.*)", rest).groups()  # type: ignore[union-attr]
        remark = said.strip()
        before, _, after = remark.partition(" so ")
        is_remark = _REMARK.match(before) and _is_idle(before, known, scene)
        if after and (is_remark or _find_topic(before, f"so {after}", known, scene) is not None):
            remark, rest = before, f"so {after}{mark} {rest}"
        if _REMARK.match(remark) and _is_idle(remark, known, scene):
            dropped.append(remark)
            rest = rest.removeprefix("so ")
        elif rest and (topic := _find_topic(remark, rest, known, scene)) is not None:
            dropped.append(remark)
            rest = rest.removeprefix("so ")
            if topic and not re.match(rf"(?:(?!{_join(scene)})[^,;])*?\b(?:it|them)\b", rest):
                text += f"{topic} , "  # `the tray is dirty, take the can out of it`
            elif topic:
                rest = re.sub(r"\b(?:it|them)\b", topic, rest, count=1)
        elif (
            text
            and re.match(r"(?:it|they) (?:is|are|was|has|have|looks?|seems?)\b", remark)
            and not _is_said(remark, scene)
        ):
            dropped.append(remark)
        else:
            text += f"{said.rstrip()} {mark} "
    return text, dropped


def _drop_courtesies(text: str) -> str:
    text = _SOUND.sub("", text)
    text = re.sub(r"(^|[,;] )i (?:think|guess|suppose|believe|reckon|figure)(?: that)? (?!not\b)", r"\1", text)
    text = _WISH.sub(lambda found: f"{found[1]} should " if found[2] else f"i want {found[1]} to be", text)
    return _COURTESY.sub(lambda found: f"{found[1]}{'do not ' if found[2] else ''}", text)


def _join(words: Set[str]) -> str:
    return rf"\b(?:{'|'.join(sorted(map(re.escape, words), key=len, reverse=True))})\b"


def _is_said(remark: str, scene: Set[str]) -> bool:
    """Whether a remark names an object, a number or what is wished for."""
    return bool(_WISHED.search(remark) or re.search(r"\d", remark) or not scene.isdisjoint(remark.split()))


def _is_idle(said: str, known: Set[str], scene: Set[str]) -> bool:
    """Whether words could be no part of a goal: one at least is unknown, none is of the scene, a number or weighty."""
    spoken = {
        *re.findall(r"[a-z][a-z'-]*|\d+", re.sub(r"\b(?:can|could|do|does|am|is|are|has|have|will) not\b", "", said))
    }
    strange = spoken - known
    return (
        bool(strange)
        and spoken.isdisjoint({*scene, *read_lexicon()["weighty"]["words"]})
        and not any(map(str.isdigit, spoken))
    )


def _find_topic(remark: str, later: str, known: Set[str], scene: Set[str]) -> str | None:
    """What a remark about an object leaves for a later `it`: the object's phrase, or nothing; None if it is none."""
    words = _join(scene)
    refers = bool(re.search(r"\b(?:it|them|they|ones?)\b", later))
    phrases = re.findall(
        r"\b(?:(?:the|all the) (?:stuff|things|objects) (?:under|below|on|in|inside|behind) )?"
        rf"(?:(?:the|my|our|this|that|these|those|an?|some) )?(?:(?!can not ){words} ?)+",
        remark,
    )
    if refers and phrases and _STATEMENT.match(remark) and not _WISHED.search(remark):
        return re.sub(r"^(?:my|our|this|that|these|those|an?|some) |^(?!the )", "the ", phrases[0]).strip()
    if re.match(r"there (?:is|are)\b", remark):
        return None
    if stated := re.fullmatch(
        rf"((?:the|my|our|this) (?:{words} ?)+)(?:is|are|was|were|looks?|seems?|fell|has|have|got|keeps?)\b(.*)",
        remark,
    ):
        is_idle = _is_idle(remark.removeprefix(stated[1]), known - {"mess", "way", "fallen"}, scene)
        return "" if is_idle and not refers else None
    if not _FIRST_PERSON.match(remark) or not (
        later.startswith("so ") or not re.match(r"\w+ (?:need|want|have|would)", remark)
    ):
        return None
    if not refers:
        return ""
    return phrases[0].strip() if len(phrases) == 1 else None
