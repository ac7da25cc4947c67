"""Text that every document can hold, made of whatever a keyboard, a terminal or another program left.

Upstream: reasons and names that anybody writes. Downstream: JSON, YAML and Markdown, which refuse some characters: a
control character, half of a pair of surrogates.
"""

import re

_UNFIT = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # YAML 1.1, section 5.1
_INSTEAD = "\N{REPLACEMENT CHARACTER}"


def clean(text: str) -> str:
    """The same text; both halves of a surrogate pair become its character, what no document holds a replacement."""
    if text.isascii() and text.isprintable():
        return text
    whole = text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
    return _UNFIT.sub(_INSTEAD, whole)
