"""Plots of a run as SVG in its page: First and Final by task and setting, the same failure again, and retention."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from html import escape

from phyagentos.bench.report import Rate
from phyagentos.bench.summary import ONE_PASS, Row, Summary, name_setting

WIDTH, HEIGHT, LEFT, TOP, FLOOR = 1200, 300, 50, 34, 258  # of the drawing; the floor is a share of 0
COLOURS = ("#1f5fa8", "#b3401f", "#2f7d4f", "#7a4fa3", "#8a6d00", "#3c7a89", "#a83272", "#555f6b")
Groups = Mapping[tuple[str, str], Sequence[Row]]  # by task and pass


def draw_plots(summary: Summary) -> str:
    """Every plot that the run has more than one value for; empty for one setting in one pass."""
    settings = list(summary.retention)
    passes = list(dict.fromkeys(phase for each in summary.retention.values() for phase in each))
    if len(settings) < 2 and len(passes) < 2:
        return ""
    groups: dict[tuple[str, str], list[Row]] = {}
    rows = (row for row in summary.rows if row.task and row.episodes)
    for row in sorted(rows, key=lambda row: passes.index(row.axes["pass"] or ONE_PASS)):
        groups.setdefault((row.task, row.axes["pass"]), []).append(row)
    plots = (
        _draw_bars("Final, and First as the filled part", groups, settings, lambda row: (row.final, row.first)),
        _draw_bars("The same failure again", groups, settings, lambda row: (row.repeats, row.repeats)),
        _draw_lines("Met without any repair, seed by seed", summary.retention, passes),
    )
    return f"<h2>Plots</h2>{''.join(plots)}"


def _draw_bars(title: str, groups: Groups, settings: Sequence[str], read: Callable[[Row], tuple[Rate, Rate]]) -> str:
    """Bars of each setting side by side, group by group: the outline is the first rate, the filled part the second."""
    marks = [*_draw_frame(settings)]
    slot = (WIDTH - LEFT) / len(groups)
    bar = 0.8 * slot / len(settings)
    for index, (group, rows) in enumerate(groups.items()):
        x = LEFT + index * slot
        marks += [_write(x + slot / 2, FLOOR + 16 * line, word) for line, word in enumerate(group, 1)]
        for row in rows:
            number = settings.index(name_setting(row.axes["policy"], row.axes["setting"], row.axes["verification"]))
            left, colour = x + 0.1 * slot + number * bar, COLOURS[number % len(COLOURS)]
            says = f"{' '.join(group)}, {settings[number]}: " + ", ".join(dict.fromkeys(map(str, read(row))))
            for rate, style in zip(read(row), (f"fill:none;stroke:{colour}", f"fill:{colour}"), strict=True):
                if rate.trials:
                    y = _place(rate.value)
                    box = f"x='{left:.1f}' y='{y:.1f}' width='{0.9 * bar:.1f}' height='{max(FLOOR - y, 2.0):.1f}'"
                    marks.append(f"<rect {box} style='{style}'><title>{escape(says)}</title></rect>")
    return _wrap(title, marks)


def _draw_lines(title: str, curves: Mapping[str, Mapping[str, Sequence[float]]], passes: Sequence[str]) -> str:
    """A line of each setting over the seeds of all passes; each pass begins at a line of its own."""
    marks = [*_draw_frame([*curves])]
    longest = {phase: max(len(each.get(phase, ())) for each in curves.values()) for phase in passes}
    step = (WIDTH - LEFT) / sum(longest.values())
    x = float(LEFT)
    for phase, count in longest.items():
        marks.append(f"<path d='M{x:.1f} {TOP}V{FLOOR}' stroke='#9aa6b2' stroke-dasharray='3 4'/>")
        marks.append(_write(x + count * step / 2, FLOOR + 16, phase))
        for number, curve in enumerate(curves.values()):
            places = [(x + (i + 0.5) * step + 5 * number, _place(y)) for i, y in enumerate(curve.get(phase, ()))]
            colour, line = COLOURS[number % len(COLOURS)], " ".join(f"{u:.1f},{v:.1f}" for u, v in places)
            marks.append(f"<polyline points='{line}' fill='none' stroke='{colour}' stroke-width='2'/>")
            marks += [f"<circle cx='{u:.1f}' cy='{v:.1f}' r='4' fill='{colour}'/>" for u, v in places]
        x += count * step
    return _wrap(title, marks)


def _draw_frame(settings: Sequence[str]) -> Iterator[str]:
    """The share axis, and the colour of each setting."""
    for share in (0.0, 0.5, 1.0):
        y = _place(share)
        yield f"<path d='M{LEFT} {y:.1f}H{WIDTH}' stroke='#dde3ea'/>"
        yield _write(LEFT - 8, y + 4, f"{100 * share:.0f} %", "end")
    for number, name in enumerate(settings):
        x = LEFT + number * (WIDTH - LEFT) / len(settings)
        yield f"<rect x='{x:.1f}' y='6' width='12' height='12' fill='{COLOURS[number % len(COLOURS)]}'/>"
        yield _write(x + 18, 17, name, "start")


def _place(share: float) -> float:
    return FLOOR - share * (FLOOR - TOP)


def _write(x: float, y: float, text: str, anchor: str = "middle") -> str:
    return f"<text x='{x:.1f}' y='{y:.1f}' text-anchor='{anchor}'>{escape(text)}</text>"


def _wrap(title: str, marks: Sequence[str]) -> str:
    size = f"viewBox='0 0 {WIDTH} {HEIGHT}' role='img' aria-label='{escape(title)}'"
    return f"<h3>{escape(title)}</h3><svg {size} font-size='13' fill='#1c2430'>{''.join(marks)}</svg>"
