"""XML as elements, each at its line and column; what is no XML is reported with its place in the file."""

from dataclasses import dataclass, field
from typing import NoReturn
from xml.parsers import expat

from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.yaml_bounds import DEPTH_MAX, TOO_DEEP

ELEMENTS_MAX = 20_000  # of a file that is imported
EXPLICIT = frozenset({"Action", "Condition", "Control", "Decorator"})  # <Action ID="move_to"/> is <move_to/>
_ERRORS = {  # of expat, by its sentence
    "mismatched tag": "an end tag that is not of the element open last",
    "no element found": "an end of the file before every element is closed, or nothing",
    "duplicate attribute": "an attribute twice in one element",
    "junk after document element": "a second element beside the outermost",
    "undefined entity": "an entity such as &name; that XML does not have",
    "unclosed token": "an element or quote that is not closed",
    "unclosed CDATA section": "a CDATA section that is not closed",
    "XML or text declaration not at start of entity": "<?xml …?> after the first letter of the file",
    "unbound prefix": "a prefix without its xmlns",
}
_TOKEN = "a letter that cannot stand here: & is written &amp;, < is written &lt;, and every value has quotes"


@dataclass(frozen=True, slots=True)
class Element:
    """One element of an XML file, and where it begins: line and column, counted from 1."""

    tag: str
    id: str = ""
    attributes: dict[str, str] = field(default_factory=dict)
    mark: tuple[int, int] = (1, 1)
    children: list["Element"] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)


def parse_elements(text: str, source: str) -> Element:
    """The outermost element; raises DefinitionError `SYNTAX`."""
    parser = expat.ParserCreate()
    opened, count = [Element("")], 0

    def get_mark() -> tuple[int, int]:
        return parser.CurrentLineNumber, parser.CurrentColumnNumber + 1

    def refuse(found: str) -> NoReturn:
        line, column = get_mark()
        raise DefinitionError.of("SYNTAX", f"{source}:{line}:{column}", found, "well-formed XML without DOCTYPE")

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > ELEMENTS_MAX:
            refuse(f"more than {ELEMENTS_MAX} elements")
        if len(opened) > DEPTH_MAX:
            refuse(TOO_DEEP)
        opened.append(Element(tag, attributes.pop("ID", ""), attributes, get_mark()))
        opened[-2].children.append(opened[-1])

    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda _: opened.pop()
    parser.CharacterDataHandler = lambda text: opened[-1].texts.append(text)  # noqa: PLW0108 - of the one open then
    parser.StartDoctypeDeclHandler = lambda *_: refuse("a DOCTYPE")
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        refuse(_ERRORS.get(expat.ErrorString(error.code), _TOKEN))
    return opened[0].children[0]
