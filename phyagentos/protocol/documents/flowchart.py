"""A graph to draw, and how it is written in Mermaid; `pictures.layers` draws the same as SVG."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from phyagentos.protocol.documents.markdown import escape_label

_SHAPES = {"subtree": ("[[", "]]"), "control": ("([", "])")}  # by kind; all others are rectangles


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """A vertex.

    Attributes:
        title: First line.
        below: Lines below it; as SVG only the first, of one with a picture the first two.
        kind: Classes of the style sheet, the first one decides the shape.
        link: Where it leads.
        hint: Shown on hovering.
        picture: Address of one that stands in it, as SVG.
    """

    name: str
    title: str
    below: Sequence[str] = ()
    kind: str = ""
    link: str = ""
    hint: str = ""
    picture: str = ""


@dataclass(frozen=True, slots=True)
class Arrow:
    """An edge between boxes of these names."""

    before: str
    after: str
    label: str = ""
    is_dashed: bool = False


def render_flowchart(
    boxes: Sequence[Box], arrows: Iterable[Arrow], *, direction: str = "TD", styles: Mapping[str, str] | None = None
) -> str:
    """A Mermaid flowchart; `direction` is `TD` or `LR`, `styles` the style of each kind."""
    ids = {box.name: f"n{index}" for index, box in enumerate(boxes)}
    lines = [f"flowchart {direction}"]
    for box in boxes:
        left, right = _SHAPES.get(box.kind, ("[", "]"))
        label = "<br/>".join((f"<b>{escape_label(box.title)}</b>", *map(escape_label, box.below)))
        lines.append(f'    {ids[box.name]}{left}"{label}"{right}{f":::{box.kind}" if styles else ""}')
    for each in arrows:
        begin, end = ("-.", ".->") if each.is_dashed else ("--", "-->")
        arrow = f'{begin} "{escape_label(each.label)}" {end}' if each.label else end
        lines.append(f"    {ids[each.before]} {arrow} {ids[each.after]}")
    lines += [f"    classDef {kind} {style}" for kind, style in (styles or {}).items()]
    return "\n".join(lines) + "\n"
