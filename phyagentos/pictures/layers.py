"""Graphs in layers, as SVG that needs no program to look at: what comes first stands above."""

from collections.abc import Iterable, Sequence
from html import escape

import networkx

from phyagentos.protocol.documents.flowchart import Arrow, Box

HEIGHT, BETWEEN, GAP, LETTER, MARGIN = 40, 44, 18, 7.0, 10  # pixels
PICTURE, LINE = (112, 84), 15  # width and height of a picture in a box, height of a line of text below it
STYLE = """
.box rect{fill:#eceff1;stroke:#78909c}.box text{fill:#263238;font:12px sans-serif;text-anchor:middle}
.box .sub{fill:#455a64;font-size:11px}.edge{stroke:#78909c;fill:none}.edge.other{stroke-dasharray:5 3}
.note{fill:#546e7a;font:10px sans-serif;text-anchor:middle;paint-order:stroke;stroke:#fff;stroke-width:4px}
.ready rect{fill:#e3f2fd;stroke:#1e88e5}.active rect,.here rect{fill:#fff3e0;stroke:#e65100;stroke-width:2}
.done rect{fill:#e8f5e9;stroke:#388e3c}.blocked rect,.invalidated rect{fill:#ffebee;stroke:#c62828}
.skipped rect{fill:#fafafa;stroke:#b0bec5}.rescued rect{fill:#f9fbe7;stroke:#827717}.past rect{fill:#fff}
.been rect{fill:#e8eaf6;stroke:#3949ab}.found rect{stroke-width:3}
.leaf rect{fill:#e8f1fb;stroke:#3b78b5}.subtree rect{fill:#f3ecfa;stroke:#7d56a8}
.control rect{fill:#f4f4f1;stroke:#77756c}
"""


def draw_layers(boxes: Sequence[Box], arrows: Iterable[Arrow], label: str) -> str:
    """A stand-alone SVG; `label` says what it shows to those who do not see it.

    An arrow that leads to an earlier box of the sequence does not count for the layers.
    """
    order = {box.name: index for index, box in enumerate(boxes)}
    arrows = [each for each in dict.fromkeys(arrows) if each.before in order and each.after in order]
    ahead = networkx.DiGraph((each.before, each.after) for each in arrows if order[each.before] < order[each.after])
    ahead.add_nodes_from(order)
    layers = _sort_layers(
        [sorted(names, key=order.__getitem__) for names in networkx.topological_generations(ahead)], ahead
    )
    width_of = {box.name: _compute_width(box) for box in boxes}
    tall = HEIGHT + (PICTURE[1] + LINE if any(box.picture for box in boxes) else 0)
    widths = [sum(width_of[name] + GAP for name in names) - GAP for names in layers]
    width = max(widths, default=0.0) + 2 * MARGIN
    at: dict[str, tuple[float, float]] = {}
    for level, names in enumerate(layers):
        left = (width - widths[level]) / 2
        for name in names:
            at[name] = (left + width_of[name] / 2, MARGIN + level * (tall + BETWEEN))
            left += width_of[name] + GAP
    height = MARGIN * 2 + (len(layers) - 1) * (tall + BETWEEN) + tall if layers else 0
    shapes = [
        *(_draw_arrow(each, at, tall) for each in arrows),
        *(_draw_box(box, *at[box.name], tall) for box in boxes),
    ]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" '
        f'role="group" aria-label="{escape(label)}"><style>{STYLE}</style>'
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0 8 4 0 8z" fill="#78909c"/></marker></defs>' + "".join(shapes) + "</svg>"
    )


def _compute_width(box: Box) -> float:
    """In pixels."""
    least = PICTURE[0] + 12.0 if box.picture else 64.0
    return max(least, max(map(len, (box.title, *_list_lines(box)))) * LETTER + 18)


def _list_lines(box: Box) -> Sequence[str]:
    return box.below[: 2 if box.picture else 1]


def _sort_layers(layers: list[list[str]], graph: "networkx.DiGraph[str]") -> list[list[str]]:
    """Each layer by the mean place of what comes before, so that fewer arrows cross."""
    place: dict[str, float] = {}
    for names in layers:
        for index, name in enumerate(names):
            before = [place[each] for each in graph.predecessors(name)]
            place[name] = sum(before) / len(before) if before else index / max(1, len(names) - 1)
        names.sort(key=place.__getitem__)
        place |= {name: index / max(1, len(names) - 1) for index, name in enumerate(names)}
    return layers


def _draw_arrow(arrow: Arrow, at: dict[str, tuple[float, float]], tall: int) -> str:
    layer = tall + BETWEEN
    (left, top), (right, bottom) = at[arrow.before], at[arrow.after]
    if bottom > top + layer:  # past other boxes, in a bow around them
        bow = max(left, right) + 20 + 6 * (bottom - top) / layer
        path = f"M{left:.0f} {top + tall}C{bow:.0f} {top + layer} {bow:.0f} {bottom - layer} {right:.0f} {bottom}"
        where = (left + right + 2 * bow) / 4, (top + tall + bottom) / 2
    elif bottom > top:
        path = f"M{left:.0f} {top + tall}C{left:.0f} {top + layer - 16} {right:.0f} {bottom - 30} {right:.0f} {bottom}"
        where = (left + right) / 2, (top + tall + bottom) / 2 + 3
    else:  # back, around the side
        side = max(left, right) + 70
        end = f"{right:.0f} {bottom + tall}"
        path = f"M{left:.0f} {top + tall / 2}C{side:.0f} {top} {side:.0f} {bottom + tall} {end}"
        where = side - 22, (top + bottom) / 2 + tall / 2
    kind, note = ("edge other", _draw_text("note", *where, arrow.label)) if arrow.label else ("edge", "")
    return f'<path class="{kind}" d="{path}" marker-end="url(#tip)"/>{note}'


def _draw_box(box: Box, middle: float, top: float, tall: int) -> str:
    rows = [_draw_text("", middle, top + (17 if box.below else 25), box.title)]
    rows += [_draw_text("sub", middle, top + 32 + LINE * row, text) for row, text in enumerate(_list_lines(box))]
    width = _compute_width(box)
    if box.picture:
        place = f'x="{middle - PICTURE[0] / 2:.0f}" y="{top + tall - PICTURE[1] - 6:.0f}"'
        size = f'width="{PICTURE[0]}" height="{PICTURE[1]}"'
        rows.append(f'<image href="{escape(box.picture)}" {place} {size} preserveAspectRatio="xMidYMid slice"/>')
    shape = (
        f'<g class="box {escape(box.kind)}"><title>{escape(box.hint or box.title)}</title>'
        f'<rect x="{middle - width / 2:.0f}" y="{top:.0f}" width="{width:.0f}" height="{tall}" rx="7"/>'
        f"{''.join(rows)}</g>"
    )
    return f'<a href="{escape(box.link)}">{shape}</a>' if box.link else shape


def _draw_text(kind: str, x: float, y: float, text: str) -> str:
    return f'<text class="{kind}" x="{x:.0f}" y="{y:.0f}">{escape(text)}</text>'
