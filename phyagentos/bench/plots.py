"""Plots of a run as SVG in its page: First and Final by task and setting, the same failure again, and retention."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from html import escape

from phyagentos.bench.report import Rate
from phyagentos.bench.summary import Row, Summary

WIDTH, HEIGHT, LEFT, TOP, BOTTOM = 1000, 300, 50, 34, 46
COLOURS = ("#1f5fa8", "#b3401f", "#2f7d4f", "#7a4fa3", "#8a6d00", "#3c7a89", "#a83272", "#555f6b")


def draw_plots(summary: Summary) -> str:
    """Every plot that the run has more than one value for; empty for one setting in one pass."""
    rows = [row for row in summary.rows if row.task] or [*summary.rows]
    names = list(dict.fromkeys(map(_name_setting, rows)))
    passes = list(dict.fromkeys(row.axes["pass"] for row in rows))
    if len(names) < 2 and len(passes) < 2:
        return ""
    tasks = dict.fromkeys((row.task, row.axes["pass"]) for row in rows)
    groups = {
        f"{task} {phase}".strip(): [row for row in rows if (row.task, row.axes["pass"]) == (task, phase)]
        for task, phase in tasks
    }
    plots = (
        _draw_bars("Final, and First as the filled part", groups, names, lambda row: (row.final, row.first)),
        _draw_bars("The same failure again", groups, names, lambda row: (row.repeats, row.repeats)),
        _draw_lines("Met without any repair, seed by seed", summary.retention, names),
    )
    return f"<h2>Plots</h2>{''.join(plots)}"


def _name_setting(row: Row) -> str:
    return " ".join(filter(None, (row.axes["policy"], row.axes["setting"], row.axes["verification"]))) or "all"


def _draw_bars(
    title: str, groups: Mapping[str, Sequence[Row]], names: Sequence[str], read: Callable[[Row], tuple[Rate, Rate]]
) -> str:
    """Bars of each setting side by side, group by group: the outline is the first rate, the filled part the second."""
    marks = [*_draw_frame(names)]
    slot = (WIDTH - LEFT) / max(len(groups), 1)
    bar = 0.8 * slot / len(names)
    for index, (group, rows) in enumerate(groups.items()):
        x = LEFT + index * slot
        marks.append(_write(x + slot / 2, HEIGHT - BOTTOM + 16 + 14 * (index % 2), group))
        for row in rows:
            number = names.index(_name_setting(row))
            left, colour = x + 0.1 * slot + number * bar, COLOURS[number % len(COLOURS)]
            says = f"{group}, {names[number]}: " + ", ".join(dict.fromkeys(map(str, read(row))))
            for rate, style in zip(read(row), (f"fill:none;stroke:{colour}", f"fill:{colour}"), strict=True):
                if rate.trials:
                    y, height = _place(rate.value), HEIGHT - BOTTOM - _place(rate.value)
                    box = f"x='{left:.1f}' y='{y:.1f}' width='{0.9 * bar:.1f}' height='{height:.1f}'"
                    marks.append(f"<rect {box} style='{style}'><title>{escape(says)}</title></rect>")
    return _wrap(title, marks)


def _draw_lines(title: str, curves: Mapping[str, Mapping[str, Sequence[float]]], names: Sequence[str]) -> str:
    """A line of each setting over the seeds of all passes; each pass begins at a line of its own."""
    marks = [*_draw_frame(names)]
    longest = {
        name: max(len(each.get(name, ())) for each in curves.values()) for each in curves.values() for name in each
    }
    step = (WIDTH - LEFT) / max(sum(longest.values()), 1)
    begin = 0
    for phase, count in longest.items():
        x = LEFT + begin * step
        marks.append(f"<path d='M{x:.1f} {TOP}V{HEIGHT - BOTTOM}' stroke='#9aa6b2' stroke-dasharray='3 4'/>")
        marks.append(_write(x + count * step / 2, HEIGHT - BOTTOM + 16, phase))
        for number, name in enumerate(names):
            values = curves.get(name, {}).get(phase, ())
            spots = [f"{x + (i + 0.5) * step + 4 * number:.1f},{_place(value):.1f}" for i, value in enumerate(values)]
            colour = COLOURS[number % len(COLOURS)]
            marks.append(f"<polyline points='{' '.join(spots)}' fill='none' stroke='{colour}' stroke-width='2'/>")
            marks += [
                f"<circle cx='{x}' cy='{y}' r='4' fill='{colour}'/>" for x, y in (spot.split(",") for spot in spots)
            ]
        begin += count
    return _wrap(title, marks)


def _draw_frame(names: Sequence[str]) -> Iterator[str]:
    """The share axis, and the colour of each setting."""
    for share in (0.0, 0.5, 1.0):
        y = _place(share)
        yield f"<path d='M{LEFT} {y:.1f}H{WIDTH}' stroke='#dde3ea'/>"
        yield _write(LEFT - 8, y + 4, f"{100 * share:.0f} %", "end")
    for number, name in enumerate(names):
        x = LEFT + number * (WIDTH - LEFT) / len(names)
        yield f"<rect x='{x:.1f}' y='6' width='12' height='12' fill='{COLOURS[number % len(COLOURS)]}'/>"
        yield _write(x + 18, 17, name, "start")


def _place(share: float) -> float:
    return HEIGHT - BOTTOM - share * (HEIGHT - TOP - BOTTOM)


def _write(x: float, y: float, text: str, anchor: str = "middle") -> str:
    return f"<text x='{x:.1f}' y='{y:.1f}' text-anchor='{anchor}'>{escape(text)}</text>"


def _wrap(title: str, marks: Sequence[str]) -> str:
    size = f"viewBox='0 0 {WIDTH} {HEIGHT}' role='img' aria-label='{escape(title)}'"
    return f"<h3>{escape(title)}</h3><svg {size} font-size='13' fill='#1c2430'>{''.join(marks)}</svg>"
