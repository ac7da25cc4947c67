"""HISTORY.md: sessions of 0.1.x that are not pending, as its documents claim them; nothing of it was verified here.

Upstream: `conversion`. It is a record for people and stands beside the journal, never in it: the journal admits only
transitions that happened here, and verdicts that rest on evidence.
"""

import re
from collections.abc import Sequence
from typing import Any

import yaml

from phyagentos.protocol.legacy.documents import Entry
from phyagentos.protocol.markdown import render_table

_Dumper: type[yaml.SafeDumper] = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
_HEAD = """# Sessions of the old system

Claimed by the old system, **not verified**: these sessions ran under 0.1.x, or were under way when its documents were
copied. They left no evidence that could be judged here, so they are no records of the journal, satisfy no dependency
and count for no skill. What was pending is not here: it became drafts in `project/goal_graphs/`.

"""
_FINAL = frozenset({"succeeded", "failed", "replanned", "timed_out", "cancelled", "rejected"})


def render_history(entries: Sequence[Entry]) -> str:
    """A table, then each session with every field as it stood; empty without any."""
    if not entries:
        return ""
    rows = [
        (
            _text(entry.data.get("session_id")),
            _text(entry.data.get("status")) + ("" if entry.data.get("status") in _FINAL else " (unfinished)"),
            _text(entry.data.get("updated_at")),
            _text(entry.data.get("task_description")),
            _text(_find_code(entry.data)),
            entry.address_of(),
        )
        for entry in entries
    ]
    table = render_table(("session", "claimed state", "updated", "task", "error code", "stood at"), rows)
    return f"{_HEAD}{table}\n" + "\n".join(_render_entry(entry) for entry in entries)


def _render_entry(entry: Entry) -> str:
    text = yaml.dump(entry.data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=110)
    longest = max((len(run) for run in re.findall("`+", text)), default=0)
    fence = "`" * max(3, longest + 1)
    return f"## {_text(entry.data.get('session_id'))}\n\n{fence}yaml\n{text}{fence}\n"


def _find_code(data: dict[Any, Any]) -> Any:
    result = data.get("result")
    return result.get("error_code") if isinstance(result, dict) else None


def _text(value: Any) -> str:
    return "" if value is None else " ".join(str(value).split())
