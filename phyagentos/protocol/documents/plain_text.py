"""Text that JSON, YAML and Markdown can hold: no control characters, no half of a surrogate pair."""

import re
from functools import cache

_INSTEAD = "\N{REPLACEMENT CHARACTER}"


def clean(text: str) -> str:
    """The same text; surrogate pairs become their character, other unfit characters a replacement."""
    if text.isascii() and text.isprintable():
        return text
    whole = text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
    return _find_unfit().sub(_INSTEAD, whole)


@cache
def _find_unfit() -> re.Pattern[str]:
    """Compiled at the first need: it takes as long as the rest of opening a workspace."""
    return re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # YAML 1.1, section 5.1
