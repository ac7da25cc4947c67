"""The report of a run: Markdown, JSON, and one HTML page that needs nothing beside it and leads to every bundle."""

import base64
import io
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

import msgspec
from PIL import Image

from phyagentos.bench.records import EpisodeRecord
from phyagentos.bench.report import Rate, Spread
from phyagentos.bench.summary import Row, Summary
from phyagentos.protocol.documents.durable_files import replace_durably
from phyagentos.protocol.documents.markdown import render_table
from phyagentos.protocol.sessions.evidence import PICTURE_AFTER, PICTURE_BEFORE

NAMES = ("report.md", "report.json", "report.html")
PICTURES_MAX, WIDTH_PX = 300, 192  # episodes with pictures, failures first
_AXES = ("pass", "policy", "setting", "verification")
_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;max-width:1200px;margin:2rem auto;padding:0 1rem;color:#1c2430}
h1{margin-bottom:.2rem}table{border-collapse:collapse;margin:1rem 0;display:block;overflow-x:auto}
th,td{border-bottom:1px solid #dde3ea;padding:.35rem .7rem;text-align:left;vertical-align:top;white-space:nowrap}
th{background:#f3f6f9;white-space:normal}tr.all td{font-weight:600}
.bar{position:relative;width:8rem;height:.7rem;background:#e8edf2}
.bar i,.bar b{position:absolute;top:0;bottom:0;background:#9cc3e6}.bar b{width:2px;background:#174a7c}
details{border-bottom:1px solid #e3e8ee;padding:.35rem 0}summary{cursor:pointer}.yes{color:#12703a}.no{color:#b3261e}
img{max-width:192px;margin:.3rem .3rem .3rem 0;border:1px solid #ccd5de}code{font-size:13px}
.why{white-space:normal;max-width:44rem}
"""


def write_reports(folder: Path, summary: Summary) -> list[Path]:
    """Write the three files into the folder of the run; their paths."""
    texts = (render_markdown(summary), render_json(summary), render_html(summary, folder))
    for name, text in zip(NAMES, texts, strict=True):
        replace_durably(folder / name, text.encode())
    return [folder / name for name in NAMES]


def render_json(summary: Summary) -> str:
    """Everything, with shares and intervals beside the counts."""
    return msgspec.json.format(msgspec.json.encode(_add_intervals(msgspec.to_builtins(summary)))).decode() + "\n"


def render_markdown(summary: Summary) -> str:
    """The tables, every failure, and what is missing."""
    lines = [f"# {summary.suite}", "", summary.objective, "", f"Begun {summary.at}; {_tell_counts(summary)}.", ""]
    for title, columns, rows in _iter_tables(summary):
        lines += [f"## {title}", "", render_table(columns, rows)] if rows else []
    failed = [record for record in summary.episodes if _is_notable(record)]
    if failed:
        columns = ("episode", "verdict", "scorer", "kind", "session", "bundle", "why")
        lines += [
            "## Episodes that were not met, or misjudged",
            "",
            render_table(columns, [_tell(each) for each in failed]),
        ]
    return "\n".join(lines)


def render_html(summary: Summary, folder: Path) -> str:
    """One page; pictures are part of it, and bundles are links relative to it."""
    pictured = sorted(summary.episodes, key=lambda record: (not _is_notable(record), record.id))[:PICTURES_MAX]
    ids = {record.id for record in pictured}
    parts = [f"<h1>{escape(summary.suite)}</h1><p>{escape(summary.objective)}</p>"]
    parts.append(f"<p>Begun {escape(summary.at)}; {escape(_tell_counts(summary))}.</p>")
    for name, columns, rows in _iter_tables(summary):
        if rows:
            bars = [row.final for row in summary.rows] if name == "Success" else []
            parts.append(f"<h2>{escape(name)}</h2>{_render_html_table(columns, rows, bars)}")
    parts.append("<h2>Episodes</h2>")
    parts += [_render_episode(record, folder, with_pictures=record.id in ids) for record in summary.episodes]
    title = escape(f"{summary.suite}: report")
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{title}</title>'
    return (
        f"<!doctype html><html lang=en><head>{head}<style>{_STYLE}</style></head><body>{''.join(parts)}</body></html>\n"
    )


def _iter_tables(summary: Summary) -> Iterator[tuple[str, tuple[str, ...], list[tuple[str, ...]]]]:
    axes = tuple(axis for axis in _AXES if any(row.axes[axis] for row in summary.rows))
    is_single = all(row.task for row in summary.rows)

    def name(row: Row) -> tuple[str, ...]:
        return (*(row.axes[axis] for axis in axes), row.task or "all")

    yield (
        "Success",
        (
            *axes,
            "task",
            "episodes",
            "missing",
            "pending",
            "final",
            "first",
            "parts, first",
            "false success",
            "false failure",
        ),
        [
            (
                *name(row),
                *map(str, (len(row.episodes), row.missing, row.pending)),
                *map(_tell_rate, (row.final, row.first, row.first_parts)),
                *map(str, (len(row.false_successes), len(row.false_failures))),
            )
            for row in summary.rows
        ],
    )
    asked: list[tuple[str, ...]] = [
        (each.figure, f"{each.value:.4g}", each.asked, "yes" if each.holds else "no") for each in summary.promises
    ]
    yield "Asked for", ("figure", "value", "asked", "holds"), asked
    yield (
        "Actions and time",
        (*axes, "task", "sessions", "actions an episode", "simulated [s]", "wall [s]", "an action [ms]"),
        [
            (*name(row), str(row.sessions), *map(_tell_spread, (row.ticks, row.sim_time_s, row.wall_s, row.action_ms)))
            for row in summary.rows
        ],
    )
    yield (
        "Where the time of a session goes [ms]",
        (*axes, "task", "stage", "sessions", "median", "95 %"),
        [
            (*name(row), stage, str(spread.count), f"{spread.median:.1f}", f"{spread.p95:.1f}")
            for row in summary.rows
            if not row.task or is_single
            for stage, spread in row.stages_ms.items()
        ],
    )
    yield (
        "Kinds of failure",
        (*axes, "task", "kind", "episodes", "sessions"),
        [
            (*name(row), kind, str(row.taxa.get(kind, 0)), str(row.missed_sessions.get(kind, 0)))
            for row in summary.rows
            for kind in sorted({*row.taxa, *row.missed_sessions})
        ],
    )
    yield (
        "Versions",
        ("what", "version", "episodes"),
        [(what, version, str(count)) for what, each in summary.versions.items() for version, count in each.items()],
    )
    yield "Missing", ("episode", "why"), list(summary.missing.items())


def _tell_counts(summary: Summary) -> str:
    ended, missing, pending = len(summary.episodes), len(summary.missing), len(summary.pending)
    return f"{ended} episodes ended, {missing} are missing, {pending} are pending"


def _tell_rate(rate: Rate) -> str:
    return str(rate) if rate.trials else "-"


def _tell_spread(spread: Spread) -> str:
    return f"{spread.median:.4g} (95 %: {spread.p95:.4g})" if spread.count else "-"


def _is_notable(record: EpisodeRecord) -> bool:
    return not record.is_met or record.verdict != "success"


def _tell(record: EpisodeRecord) -> tuple[str, ...]:
    """A failure in a line: which session decided, and where its evidence is."""
    missed = next((each for each in reversed(record.sessions) if each.taxon), None)
    last = missed or (record.sessions[-1] if record.sessions else None)
    why = record.error.strip().splitlines()[-1] if record.error else record.reason or (last.reason if last else "")
    scored = {True: "met", False: "not met", None: "cannot say"}[record.is_met]
    place = (last.id, last.bundle) if last else ("-", record.folder)
    return (record.id, record.verdict or record.ended, scored, record.taxon, *place, why.replace("\n", " "))


def _render_html_table(head: Sequence[str], rows: Sequence[Sequence[str]], bars: Sequence[Rate]) -> str:
    """A table; with `bars` the column `final` shows each row's share and its interval."""
    lines = ["<table><tr>" + "".join(f"<th>{escape(cell)}</th>" for cell in head) + "</tr>"]
    for index, row in enumerate(rows):
        cells = [f"<td class=why>{escape(cell)}</td>" if len(cell) > 80 else f"<td>{escape(cell)}</td>" for cell in row]
        if bars:
            place = head.index("final")
            cells[place] = cells[place].replace("</td>", f"{_render_bar(bars[index])}</td>")
        lines.append(f"<tr{' class=all' if 'all' in row else ''}>{''.join(cells)}</tr>")
    return "".join([*lines, "</table>"])


def _render_bar(rate: Rate) -> str:
    if not rate.trials:
        return ""
    low, high = (100 * bound for bound in rate.interval)
    span = f"<i style='left:{low:.1f}%;width:{high - low:.1f}%'></i><b style='left:{100 * rate.value:.1f}%'></b>"
    return f"<div class=bar>{span}</div>"


def _render_episode(record: EpisodeRecord, folder: Path, *, with_pictures: bool) -> str:
    mark = "<span class=yes>met</span>" if record.is_met else "<span class=no>not met</span>"
    kind = f", {escape(record.taxon)}" if record.taxon else ""
    verdict = escape(record.verdict or record.ended)
    head = f"{mark} <code>{escape(record.id)}</code>: {verdict}{kind}, {record.wall_s:.1f} s"
    rows = "".join(
        f"<tr><td><a href='{quote(session.bundle)}/'><code>{escape(session.id)}</code></a></td>"
        f"<td>{escape(session.state)}</td><td>{escape(session.cause)}</td><td>{session.ticks}</td>"
        f"<td>{session.sim_time_s:.2f}</td><td class=why>{escape(session.reason)}</td></tr>"
        for session in record.sessions
    )
    names = ("session", "state", "cause", "actions", "simulated [s]", "why")
    table = f"<table><tr>{''.join(f'<th>{name}</th>' for name in names)}</tr>{rows}</table>" if rows else ""
    error = f"<pre>{escape(record.error)}</pre>" if record.error else ""
    pictures = "".join(_iter_pictures(record, folder)) if with_pictures else ""
    place = f"<p><a href='{quote(record.folder)}/'>{escape(record.folder)}</a>: settings {record.settings}</p>"
    return f"<details id='{quote(record.id)}'><summary>{head}</summary>{place}{table}{pictures}{error}</details>"


def _iter_pictures(record: EpisodeRecord, folder: Path) -> Iterator[str]:
    """The picture before the first session and those after each, small."""
    bundles = [folder / session.bundle for session in record.sessions]
    for path in (*(bundle / PICTURE_BEFORE for bundle in bundles[:1]), *(bundle / PICTURE_AFTER for bundle in bundles)):
        if path.is_file():
            with Image.open(path) as picture:
                picture.thumbnail((WIDTH_PX, WIDTH_PX))
                picture.convert("RGB").save(data := io.BytesIO(), "jpeg", quality=70)
            source = base64.b64encode(data.getvalue()).decode()
            yield f"<img alt='{escape(path.parent.name)} {path.stem}' src='data:image/jpeg;base64,{source}'>"


def _add_intervals(data: Any) -> Any:
    if isinstance(data, dict):
        if data.keys() == {"successes", "trials"}:
            rate = Rate(**data)
            return data | {"share": rate.value if rate.trials else None, "wilson_95": rate.interval}
        return {key: _add_intervals(value) for key, value in data.items()}
    return [_add_intervals(value) for value in data] if isinstance(data, list | tuple) else data
