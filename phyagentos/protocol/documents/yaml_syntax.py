"""What libyaml and PyYAML say of text that is no YAML, in words of the file."""

import re

import yaml

QUOTE_OPEN = "a quote that is not closed"
BRACKET_OPEN = "a list or mapping in brackets that is not closed, or lacks a comma"
_QUOTE = "Quote a text that holds ': ' or ' #', or that begins with one of [ ] { } > | * & ! % @ `."
_ALIGN = "Indent the keys of one mapping alike, with blanks."
_CLOSE = "Close every [, { and quote, and put a comma between values; in brackets '${...}' stands in quotes."
_WORDS = {  # part of the library's sentence: found, and what to do
    "mapping values are not allowed": ("a second ': ' in one line, or a key further in than those above it", _QUOTE),
    "could not find expected ':'": ("a line that is no key, as ': ' is missing", "Write 'key: value'."),
    "a tab character": ("a tab", "Indent with blanks."),
    "did not find expected key": ("a line that fits no mapping or list above it", f"{_ALIGN} Close every quote."),
    "did not find expected '-'": ("a line among the '- ' of a list that does not begin with '- '", _ALIGN),
    "did not find expected ',' or": (BRACKET_OPEN, _CLOSE),
    "did not find expected node content": ("a bracket or comma where a value is expected", _CLOSE),
    "found unexpected end of stream": (QUOTE_OPEN, "Close it."),
    "found unexpected document indicator": (QUOTE_OPEN, "Close it."),
    "found unknown escape character": ("an escape that YAML does not know", "Write \\\\ for \\, or use single quotes."),
    "escape code": ("an escape that YAML does not know", "Write \\\\ for \\, or use single quotes."),
    "undefined alias": ("an alias '*name' without its anchor '&name'", "Quote a text that begins with *."),
    "expected alphabetic or numeric": ("a * or & without a name", "Quote a text that begins with * or &."),
    "could not determine a constructor": ("a tag '!name', and none is known", "Quote a text that begins with !."),
    "undefined tag handle": ("a tag '!name', and none is known", "Quote a text that begins with !."),
    "block sequence entries are not": ("a '- ' where no list can begin", "Begin the list on a line of its own."),
    "mapping keys are not allowed": ("a '? ' where no key can begin", _QUOTE),
    "but found another document": ("a second document after '---'", "Keep one document in a file."),
    "expected <document start>": ("text after the end of the value", _ALIGN),
    "comment or line break": ("text after | or >", "Begin the text on the next line."),
    "not allowed": ("an invisible control character", "Remove it."),
    "found unhashable key": ("a list or mapping as a key", "Write a text."),
    "expected a mapping": ("'<<' that merges what is no mapping", "Merge an anchor of a mapping, as in '<<: *name'."),
}

BULLETS = "\u2013\u2014\u2212\u2022*"
_LEFTOVERS = {  # of copying, each with what is found and what to do; the line on which it is comes first
    r"^(<{7}|={7}|>{7})(?= |$)": ("a mark of an unresolved merge", "Keep one of the two versions."),
    r"^[ ]*```": ("the fence of a code block", "Remove it."),
    r"^[ ]*[^\S \n\t]": ("a blank in the indent that is none of the keyboard's", "Type the indent anew."),
    rf"^[ ]*[{BULLETS}](?= )": ("a dash or bullet that is no '-'", "Begin each item of a list with '- '."),
    r"^[ ]*(\.\.\.|\u2026)[ ]*$": ("'...', where something was left out", "Write what belongs there."),
    r"^[ ]*1[:|]?[ ]+\S.*\n[ ]*2[:|]?[ ]+\S": ("numbers of lines before the text", "Remove them."),
}


def find_leftover(text: str) -> tuple[int, str, str] | None:
    """Line, from 0, of what copying has left in a text that is not as it should be, what it is, and what to do."""
    found = ((re.search(pattern, text, re.MULTILINE), words) for pattern, words in _LEFTOVERS.items())
    return next(((text[: each.start()].count("\n"), *words) for each, words in found if each is not None), None)


def _split(said: str) -> tuple[str, str]:
    """What this project's own reader said: what was found, and behind a semicolon what to do."""
    found, _, step = said.strip().partition("; ")
    return found, step and f"{step[0].upper()}{step[1:]}."


def explain(error: yaml.YAMLError, letter: str = "") -> tuple[str, str]:
    """What was found, and what to do next; `letter` stands where the problem is."""
    said = f"{getattr(error, 'problem', None) or ''} {getattr(error, 'context', None) or ''}"
    said = said if said.strip() else str(error)
    if "cannot start any token" in said:
        return ("a tab", "Indent with blanks.") if letter == "\t" else (f"{letter!r}, which begins no value", _QUOTE)
    known = next((words for part, words in _WORDS.items() if part in said), None)
    if known is not None:
        return known
    is_ours = isinstance(error, yaml.composer.ComposerError | yaml.constructor.ConstructorError)
    return _split(said) if is_ours and getattr(error, "context", None) is None else ("text that is no YAML", _QUOTE)
