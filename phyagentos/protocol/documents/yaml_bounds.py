"""Bounds of YAML before it is built: depth, and size with every alias written out.

A few hundred bytes of aliases can stand for more values than any memory holds, and nesting overflows the recursive
composer of libyaml, which is C code.
"""

from typing import Any

import yaml

DEPTH_MAX = 200  # levels of lists and mappings
VALUES_MAX = 100_000  # keys, values, lists and mappings; some seconds and 100 MB
LETTERS_MAX = 16 << 20
TOO_DEEP = f"more than {DEPTH_MAX} levels, or an alias inside of what it stands for"
FLATTEN = "use fewer levels, and write out what such an alias should stand for"
TOO_LARGE = "more than {} values, or {} letters, once its aliases are written out; use fewer aliases, or several files"
SHORT = 10_000  # letters: too few to nest so deep that the stack of the C library overflows
_Loader: type[yaml.SafeLoader] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def check_bounds(text: str, values_max: int = VALUES_MAX) -> None:
    """Read along, nothing kept; raises YAMLError with the place where a bound is passed, or of a syntax error."""
    if len(text) <= min(SHORT, values_max) and "*" not in text:
        return
    values = letters = 0  # so far, aliases written out
    owners: list[tuple[str | None, int, int]] = []  # anchor of each open list or mapping, and the counts before it
    sizes: dict[str | None, tuple[int, int] | None] = {}  # of each anchor; None while it is open
    for event in yaml.parse(text, Loader=_Loader):
        match event:
            case yaml.CollectionStartEvent():
                owners.append((event.anchor, values, letters))
                sizes[event.anchor] = None
                values += 1
            case yaml.CollectionEndEvent():
                anchor, values_before, letters_before = owners.pop()
                sizes[anchor] = values - values_before, letters - letters_before
            case yaml.ScalarEvent():
                sizes[event.anchor] = 1, len(event.value)
                values, letters = values + 1, letters + len(event.value)
            case yaml.AliasEvent():
                size = sizes.get(event.anchor, (1, 0))
                if size is None:
                    raise refuse(f"{TOO_DEEP}; {FLATTEN}", event.start_mark)
                values, letters = values + size[0], letters + size[1]
        if len(owners) > DEPTH_MAX:
            raise refuse(f"{TOO_DEEP}; {FLATTEN}", event.start_mark)
        if values > values_max or letters > LETTERS_MAX:
            raise refuse(TOO_LARGE.format(values_max, LETTERS_MAX), event.start_mark)


def refuse(reason: str, mark: Any) -> yaml.YAMLError:
    """The error of a bound that is passed at `mark`."""
    return yaml.composer.ComposerError(None, None, reason, mark)


def load_bounded(text: str) -> Any:
    """The value of a document; raises YAMLError."""
    check_bounds(text)
    return yaml.load(text, Loader=_Loader)
