"""The report of a run: Markdown, JSON, and one HTML page that needs nothing beside it and leads to every bundle."""

import base64
import io
from collections.abc import Callable, Iterable, Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

import msgspec
from markdown_it import MarkdownIt
from PIL import Image

from phyagentos.bench.plots import draw_plots
from phyagentos.bench.records import EpisodeRecord
from phyagentos.bench.report import Rate
from phyagentos.bench.summary import GROUPED, Row, Summary
from phyagentos.protocol.documents.durable_files import replace_durably
from phyagentos.protocol.documents.markdown import render_table
from phyagentos.protocol.sessions.evidence import PICTURE_AFTER, PICTURE_BEFORE

NAMES = ("report.md", "report.json", "report.html")
PICTURES_MAX, WIDTH_PX = 300, 192  # episodes with pictures, failures first
_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;max-width:1200px;margin:2rem auto;padding:0 1rem;color:#1c2430}
table{border-collapse:collapse;margin:1rem 0;display:block;overflow-x:auto}th{background:#f3f6f9}
th,td{border-bottom:1px solid #dde3ea;padding:.35rem .7rem;text-align:left;vertical-align:top;max-width:44rem}
details{border-bottom:1px solid #e3e8ee;padding:.35rem 0}summary{cursor:pointer}.yes{color:#12703a}.no{color:#b3261e}
img{max-width:192px;margin:.3rem .3rem .3rem 0;border:1px solid #ccd5de}code{font-size:13px}
"""
Titled = tuple[str, tuple[str, ...], list[tuple[str, ...]]]
Cells = Callable[[Row], Iterable[tuple[object, ...]]]  # one line of a table each
_TABLES = MarkdownIt("zero").enable(["heading", "table"])  # no link, picture or tag that a reason might contain


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
    ended, missing, pending = map(len, (summary.episodes, summary.missing, summary.pending))
    counts = f"{ended} episodes ended, {missing} are missing, {pending} are pending"
    lines = [f"# {summary.suite}", "", summary.objective, "", f"Begun {summary.at}; {counts}.", ""]
    for title, columns, rows in _iter_tables(summary):
        lines += [f"## {title}", "", render_table(columns, rows)] if rows else []
    return "\n".join(lines)


def render_html(summary: Summary, folder: Path) -> str:
    """One page; pictures are part of it, and bundles are links relative to it."""
    pictured = sorted(summary.episodes, key=lambda record: (not _is_notable(record), record.id))[:PICTURES_MAX]
    ids = {record.id for record in pictured}
    head = f'<meta charset="utf-8"><title>{escape(summary.suite)}: report</title><style>{_STYLE}</style>'
    episodes = "".join(_render_episode(each, folder, with_pictures=each.id in ids) for each in summary.episodes)
    head_lines, mark, tables = render_markdown(summary).partition("\n## ")
    shown = f"{_TABLES.render(head_lines)}{draw_plots(summary)}{_TABLES.render(mark + tables)}"
    body = f"{shown}<h2>Episodes</h2>{episodes}"
    return f"<!doctype html><html lang=en><head>{head}</head><body>{body}</body></html>\n"


def _iter_tables(summary: Summary) -> Iterator[Titled]:
    rows, axes = summary.rows, [axis for axis in GROUPED if any(row.axes[axis] for row in summary.rows)]
    singles = [row for row in rows if row.task] or rows

    def tell(title: str, columns: tuple[str, ...], read: Cells, rows: Sequence[Row] = rows) -> Titled:
        named = [((*(row.axes[axis] for axis in axes), row.task or "all"), row) for row in rows]
        cells = [(*name, *map(str, each)) for name, row in named for each in read(row)]
        return title, (*axes, "task", *columns), cells

    counts = ("episodes", "missing", "pending", "false success", "false failure")
    yield tell(
        "Success",
        ("final", "first", "parts, first", "same failure again", *counts),
        lambda row: [
            (
                *(row.final, row.first, row.first_parts, row.repeats, len(row.episodes), row.missing, row.pending),
                *map(len, (row.false_successes, row.false_failures)),
            )
        ],
    )
    asked = [(each.figure, f"{each.value:.4g}", each.asked, "yes" if each.holds else "no") for each in summary.promises]
    yield "Asked for", ("figure", "value", "asked", "holds"), list[tuple[str, ...]](asked)
    yield from _iter_held(summary)
    yield tell(
        "Actions and time",
        ("sessions", "actions an episode", "simulated [s]", "wall [s]", "an action [ms]"),
        lambda row: [(row.sessions, row.ticks, row.sim_time_s, row.wall_s, row.action_ms)],
    )
    yield tell(
        "Where the time of a session goes [ms]",
        ("stage", "sessions", "median (95 %)"),
        lambda row: [(stage, spread.count, spread) for stage, spread in row.stages_ms.items()],
        singles,
    )
    yield tell(
        "Kinds of failure",
        ("kind", "episodes", "sessions"),
        lambda row: [
            (kind, row.taxa.get(kind, 0), row.missed_sessions.get(kind, 0))
            for kind in sorted({*row.taxa, *row.missed_sessions})
        ],
    )
    versions = [(what, at, str(n)) for what, each in summary.versions.items() for at, n in each.items()]
    yield "Versions", ("what", "version", "episodes"), list[tuple[str, ...]](versions)
    yield "Missing", ("episode", "why"), list(summary.missing.items())
    failed = ("episode", "verdict", "scorer", "kind", "session", "bundle", "why")
    notable = [_tell(record) for record in summary.episodes if _is_notable(record)]
    yield "Episodes that were not met, or misjudged", failed, notable


def _iter_held(summary: Summary) -> Iterator[Titled]:
    """What was the same for all tasks, and what was not."""
    yield "Settings of the suite", ("setting", "what it changes"), [*summary.switches.items()]
    held, differing = list[tuple[str, ...]](), list[tuple[str, ...]]()
    for row in summary.held:
        hashes = sorted({each for hashes in row.hashes.values() for each in hashes})
        held.append((row.part, "yes" if row.is_constant else "no", " ".join(hashes)))
        own = row.own if not row.is_constant else {}
        differing += [(row.part, task, " ".join(row.hashes[task]), ", ".join(says)) for task, says in own.items()]
    yield "Held constant", ("part", "the same everywhere", "hashes"), held
    yield "What differs between tasks", ("part", "task", "hashes", "there and not everywhere"), differing


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


def _render_episode(record: EpisodeRecord, folder: Path, *, with_pictures: bool) -> str:
    mark = "<span class=yes>met</span>" if record.is_met else "<span class=no>not met</span>"
    told = ", ".join(filter(None, (record.verdict or record.ended, record.taxon, f"{record.wall_s:.1f} s")))
    places = "".join(
        f"<a href='{quote(place)}/'><code>{escape(place)}</code></a> "
        for place in (record.folder, *(session.bundle for session in record.sessions))
    )
    names = ("session", "state", "cause", "actions", "simulated [s]", "why")
    rows = [(s.id, s.state, s.cause, str(s.ticks), f"{s.sim_time_s:.2f}", s.reason) for s in record.sessions]
    pictures = "".join(_iter_pictures(record, folder)) if with_pictures else ""
    return (
        f"<details id='{quote(record.id)}'><summary>{mark} <code>{escape(record.id)}</code>: {escape(told)}</summary>"
        f"<p>settings {record.settings}: {places}</p>{_TABLES.render(render_table(names, rows)) if rows else ''}"
        f"{pictures}<pre>{escape(record.error)}</pre></details>"
    )


def _iter_pictures(record: EpisodeRecord, folder: Path) -> Iterator[str]:
    """The picture before the first session and those after each, small."""
    bundles = [folder / session.bundle for session in record.sessions]
    for path in (*(bundle / PICTURE_BEFORE for bundle in bundles[:1]), *(bundle / PICTURE_AFTER for bundle in bundles)):
        if path.is_file():
            yield f"<img alt='{escape(path.parent.name)} {path.stem}' src='{shrink_picture(path)}'>"


def shrink_picture(path: Path) -> str:
    """A small copy, as an address that a page holds itself."""
    with Image.open(path) as picture:
        picture.thumbnail((WIDTH_PX, WIDTH_PX))
        picture.convert("RGB").save(data := io.BytesIO(), "jpeg", quality=70)
    return f"data:image/jpeg;base64,{base64.b64encode(data.getvalue()).decode()}"


def _add_intervals(data: Any) -> Any:
    if isinstance(data, dict):
        if data.keys() == {"successes", "trials"}:
            rate = Rate(**data)
            return data | {"share": rate.value if rate.trials else None, "wilson_95": rate.interval}
        return {key: _add_intervals(value) for key, value in data.items()}
    return [_add_intervals(value) for value in data] if isinstance(data, list | tuple) else data
