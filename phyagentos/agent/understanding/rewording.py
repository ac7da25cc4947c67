"""Other orders of the words of a request that is no sentence: what a person says whose first language has another one.

Upstream: a reading that failed. Downstream: the same reading, tried again. Words are put elsewhere and commas between
them; none is left out, so that nothing of what was said is lost.
"""

import re
from collections.abc import Collection, Iterator

_DETERMINER = r"(?:the|an?|my|your|this|that|both|all|each|every)"


def reword(text: str, nouns: Collection[str], adjectives: Collection[str], verbs: Collection[str]) -> Iterator[str]:
    """The request with adjectives before nouns, then with places behind objects, then with commas between clauses."""
    noun, adjective, verb = (
        f"(?:{'|'.join(map(re.escape, sorted(words, key=len, reverse=True)))})"
        for words in (nouns, {*adjectives} - {*nouns} or {"-"}, verbs)
    )
    phrase = rf"(?:{_DETERMINER} )?(?:(?:two|three|four|\d+) )?(?:{adjective} )*{noun}(?!\w)"
    place = rf"(?:(?:on|onto|in|into|inside|on top of|to) (?:{phrase}|it)|inside|there)"
    orders = (
        (rf"\b({noun}) ({adjective})\b(?! {noun}\b)", r"\2 \1"),
        (rf"(^|[,;] |\band |\bthen )({place}) ({verb}) ([^,;]+?)(?= [,;]| and | then |$)", r"\1\3 \4 \2"),
        (rf"\b({verb}) ({place}) ({phrase})(?= [,;]| and | then |$)", r"\1 \3 \2"),
        (rf"^((?:{_DETERMINER}|{adjective}|{noun})\b[^,;]*?) ({place}) ({verb})$", r"\3 \1 \2"),
        (rf"((?:[,;] and|[,;]|\band) )({place}) ({phrase})(?= [,;]| and | then |$)", r"\1\3 \2"),
        (rf"(^|[,;] |\band )({place}) (must|should) be ({phrase}|nothing)(?= [,;]| and | then |$)", r"\1\4 \3 be \2"),
        (rf"(?<=\w)(?<!\band)(?<!\bthen) (?=(?:{verb}) (?:{_DETERMINER}|it|them|{adjective}|{noun})\b)", " , "),
        (rf"\b({place}|it|them) (?={_DETERMINER} )", r"\1 , "),
    )
    for pattern, order in orders:
        text, count = re.subn(pattern, order, text)
        if count:
            yield re.sub(r"\s*,(?:\s*,)+", " ,", text)
