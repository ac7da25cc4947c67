"""What a start costs with many archived sessions: time above that of the interpreter, and memory per session."""

import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

from .sessions import LANE

_OPEN = """
import sys
from pathlib import Path
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.journal import Journal
journal = Journal(Path(sys.argv[1]), side=Side.RUNTIME, by="start", clock=SystemClock(), partition=sys.argv[2])
ledger = journal.open_ledger()
"""
_TELL = """
import json
pages = int(Path("/proc/self/statm").read_text().split()[1])
print(json.dumps({"bytes": pages * __import__("os").sysconf("SC_PAGE_SIZE"), "sessions": ledger.session_count}))
"""
_LIVE = """
import gc
from phyagentos.protocol.sessions.lifecycle import SessionEvent, build_statechart
def measure():
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * __import__("os").sysconf("SC_PAGE_SIZE")
claim = build_statechart().machine.events["claim"]
before = measure()
models = [SessionEvent("s", "pending", 0, "claim", "runtime") for _ in range(int(sys.argv[3]))]
for model in models:
    claim.trigger(model)
assert {model.state for model in models} == {"claimed"}
print(__import__("json").dumps({"bytes": measure() - before}))
"""
_LIVED = """
import gc, os
sys.path.insert(0, sys.argv[4])
from store_parts.sessions import store_many
def measure():
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
store_many(Path(sys.argv[1]) / "first", 2000)
before = measure()
store_many(Path(sys.argv[1]) / "second", int(sys.argv[3]))
print(__import__("json").dumps({"bytes": measure() - before}))
"""


def measure_start(stored: Path, empty: Path, repeats: int) -> dict[str, float]:
    """Start with the journal open and the ledger complete, above an interpreter that does nothing.

    The least of several is what the start costs; the median tells how busy the machine was.
    """
    ours, nothing = [], []
    for _ in range(repeats):
        nothing.append(_time("pass", empty))
        ours.append(_time(_OPEN, stored))
    sessions = _ask(_OPEN + _TELL, stored)
    none = _ask(_OPEN + _TELL, empty)
    return {
        "interpreter_start_ms": 1e3 * min(nothing),
        "start_ms_above_interpreter": 1e3 * (min(ours) - min(nothing)),
        "start_ms_above_interpreter_median": 1e3 * (statistics.median(ours) - statistics.median(nothing)),
        "start_sessions": sessions["sessions"],
        "start_bytes_per_known_session": (sessions["bytes"] - none["bytes"]) / max(1, sessions["sessions"]),
    }


def measure_life(scratch: Path, sessions: int) -> dict[str, float]:
    """What a process has grown by that recorded all of them itself, both planes at once."""
    grown = _ask(_OPEN + _LIVED, scratch, str(sessions), str(Path(__file__).parents[1]))
    return {"lived_bytes_per_known_session": grown["bytes"] / sessions}


def measure_statechart(scratch: Path, models: int) -> dict[str, float]:
    """Models under the one shared machine."""
    return {"statechart_models_mb": _ask(_OPEN + _LIVE, scratch, str(models))["bytes"] / 1e6}


def _time(code: str, root: Path) -> float:
    begin_s = time.perf_counter()
    subprocess.run([sys.executable, "-c", code, str(root), LANE], check=True)
    return time.perf_counter() - begin_s


def _ask(code: str, root: Path, *arguments: str) -> dict[str, float]:
    told = subprocess.run([sys.executable, "-c", code, str(root), LANE, *arguments], check=True, stdout=subprocess.PIPE)
    found: dict[str, float] = json.loads(told.stdout)
    return found
